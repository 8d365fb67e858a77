"""Every form of recording gives the same frames."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="recordings need rosbags: pip install 'physnet[replay]'")

from service.client import Camera
from service.client.ros import camera_of, depth_of, point_cloud_of, rotation_of, triangles_of
from service.core.depth import decode_depth
from service.replay.frames import find_topics, recorded_frames
from service.replay.recording import RecordingError, open_recording
from tests.conftest import ROOT
from tests.service.box_scene import BoxScene
from tests.service.client.answers import answer
from tests.service.replay.bags import (
    COMPRESSED,
    DEPTH,
    FRAME,
    INFO,
    PERIOD_NS,
    START_NS,
    UP,
    Scene,
    store_of,
    write_bag,
)

SCENE = BoxScene(width=64, height=48, focal_px=60.0)
COUNTS = SCENE.counts()
FORMS = ("ros1", "ros2", "ros2-mcap", "mcap", "mcap-ros1")


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("kind", ["16UC1", "32FC1", "png", "rvl"])
def test_every_recording_gives_the_same_frames(tmp_path, form, kind):
    path = write_bag(tmp_path, form, COUNTS, SCENE.camera, frames=3, kind=kind)
    with open_recording(path) as recording:
        topics = find_topics(recording)
        assert (topics.depth, topics.info) == (COMPRESSED if kind in ("png", "rvl") else DEPTH, INFO)
        frames = list(recorded_frames(recording, topics, up_frame="base_link"))
        assert recording.duration_s == pytest.approx(3e-9 * PERIOD_NS)
    assert [frame.time_ns for frame in frames] == [START_NS + n * PERIOD_NS for n in (1, 2, 3)]
    for frame in frames:
        assert (frame.stamp_ns, frame.frame_id) == (frame.time_ns, FRAME)
        assert frame.camera == Camera.from_json(SCENE.camera)
        np.testing.assert_allclose(frame.up, UP, atol=1e-12)
        depth_m = decode_depth(frame.depth.encoding, frame.depth.data, frame.depth.unit_m, 64, 48)
        want = np.where(COUNTS, COUNTS * np.float32(0.001), np.nan)
        np.testing.assert_allclose(depth_m, want, rtol=1e-6)


def test_a_real_frame_comes_through_unchanged(tmp_path):
    import cv2

    folder = ROOT / "examples" / "frames" / "mug"
    counts = cv2.imread(str(folder / "depth.png"), cv2.IMREAD_UNCHANGED)
    camera = json.loads((folder / "intrinsics.json").read_text())
    with open_recording(write_bag(tmp_path, "ros2", counts, camera, frames=1)) as recording:
        (frame,) = recorded_frames(recording, find_topics(recording))
    assert frame.depth.data == counts.astype("<u2").tobytes()
    assert frame.camera == Camera.from_json(camera)
    assert frame.up is None


def test_what_cannot_be_played_is_said_in_words(tmp_path):
    with pytest.raises(RecordingError, match="no recording"):
        open_recording(tmp_path / "none.bag")
    for name in ("x.bag", "x.mcap", "x.db3"):
        (tmp_path / name).write_bytes(b"\x89MCAP0\r\n" + bytes(50))
        with pytest.raises(RecordingError, match=name):
            open_recording(tmp_path / name)
    path = write_bag(tmp_path, "mcap", COUNTS, SCENE.camera, frames=1)
    whole = path.read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(RecordingError, match=r"cut\.mcap"):
        open_recording(tmp_path / "cut.mcap")
    with open_recording(path) as recording:
        with pytest.raises(RecordingError, match=rf"--depth: no images on /other; there are {DEPTH}"):
            find_topics(recording, depth="/other")
        with pytest.raises(RecordingError, match="--info"):
            find_topics(recording, info="/other")
        recording.topics["/second/depth"] = "sensor_msgs/msg/Image"
        with pytest.raises(RecordingError, match=r"choose with --depth: .*/second/depth"):
            find_topics(recording)
        assert find_topics(recording, depth=DEPTH).info == INFO


@pytest.mark.parametrize("form", ["ros1", "ros2"])
def test_messages_are_read_with_padding_and_either_byte_order(form):
    scene = Scene(COUNTS, SCENE.camera, store_of(form))
    for encoding in ("16UC1", "32FC1"):
        plain = depth_of(scene.image(START_NS, encoding))
        assert depth_of(scene.image(START_NS, encoding, padding=6, big_endian=True)) == plain
    assert depth_of(scene.image(START_NS)).data == COUNTS.astype("<u2").tobytes()
    colour = scene.image(START_NS)
    colour.encoding = "rgb8"
    with pytest.raises(ValueError, match="rgb8"):
        depth_of(colour)
    jpeg = scene.compressed(START_NS)
    jpeg.format = "jpeg"
    with pytest.raises(ValueError, match="jpeg"):
        depth_of(jpeg)
    short = scene.image(START_NS)
    short.width = 65
    with pytest.raises(ValueError, match="width 65"):
        depth_of(short)


def test_binning_and_region_of_interest_change_the_intrinsics():
    """A point keeps its ray: pixel (u, v) of the full image is ((u − left + ½)/2 − ½, …) of the binned part."""
    scene = Scene(COUNTS, SCENE.camera, store_of("ros2"))
    info = scene.info(START_NS)
    full = camera_of(info)
    info.binning_x = info.binning_y = 2
    info.roi.x_offset, info.roi.y_offset, info.roi.width, info.roi.height = 10, 6, 40, 30
    part = camera_of(info)
    assert (part.width, part.height) == (20, 15)
    u, v = 33.0, 21.0
    seen = ((u - 10 + 0.5) / 2 - 0.5, (v - 6 + 0.5) / 2 - 0.5)
    assert (seen[0] - part.cx) / part.fx == pytest.approx((u - full.cx) / full.fx)
    assert (seen[1] - part.cy) / part.fy == pytest.approx((v - full.cy) / full.fy)
    info.distortion_model = "equidistant"
    with pytest.raises(ValueError, match="equidistant"):
        camera_of(info)
    uncalibrated = scene.info(START_NS)
    uncalibrated.k[:] = 0.0
    with pytest.raises(ValueError, match="not calibrated"):
        camera_of(uncalibrated)


def test_a_quaternion_is_its_rotation():
    store = store_of("ros2")
    make = store.types["geometry_msgs/msg/Quaternion"]
    half = np.radians(90.0) / 2
    turn = rotation_of(make(x=0.0, y=0.0, z=2.0 * np.sin(half), w=2.0 * np.cos(half)))
    np.testing.assert_allclose(turn @ [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], atol=1e-12)
    with pytest.raises(ValueError, match="length 0"):
        rotation_of(make(x=0.0, y=0.0, z=0.0, w=0.0))


@pytest.mark.parametrize("form", ["ros1", "ros2"])
def test_a_result_becomes_messages_that_ros_can_send(form):
    """Written with the definitions of ROS and read again."""
    store, result = store_of(form), answer()
    scene = Scene(COUNTS, SCENE.camera, store)
    cloud = point_cloud_of(
        result, scene.header(START_NS), store.types["sensor_msgs/msg/PointCloud2"],
        store.types["sensor_msgs/msg/PointField"], lambda raw: np.frombuffer(raw, np.uint8),
    )  # fmt: skip
    name = "sensor_msgs/msg/PointCloud2"
    if form == "ros1":
        read = store.deserialize_ros1(store.serialize_ros1(cloud, name), name)
    else:
        read = store.deserialize_cdr(store.serialize_cdr(cloud, name), name)
    assert [field.name for field in read.fields] == ["x", "y", "z", "displacement"]
    assert read.row_step == len(read.data) == read.width * read.point_step
    rows = np.frombuffer(read.data.tobytes(), "<f4").reshape(-1, 4)
    np.testing.assert_array_equal(rows[:, :3], result.points_camera())
    assert rows[:, 3].max() == pytest.approx(result.max_displacement_m, rel=1e-3)
    (x,) = struct.unpack_from("<f", read.data.tobytes(), read.fields[0].offset + read.point_step)
    assert x == result.points_camera()[1, 0]
    corners = triangles_of(result)
    assert len(corners) == 3 * len(result.mesh().faces)
