"""Small recordings of a few frames, written by the libraries that robots' own tools are held to."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from service.core.rvl import encode_rvl

START_NS = 1_700_000_000_000_000_000
PERIOD_NS = 50_000_000
DEPTH, INFO = "/camera/depth/image_rect_raw", "/camera/depth/camera_info"
COMPRESSED = f"{DEPTH}/compressedDepth"
FRAME = "camera_depth_optical_frame"

# Camera frame: 30° down from level, on a mast whose own frame is turned about the vertical. By hand: `up` in the
# camera is (0, −cos 30°, −sin 30°), whatever the mast's turn is.
UP = (0.0, -np.cos(np.radians(30.0)), -np.sin(np.radians(30.0)))

Message = tuple[str, int, Any]


class Scene:
    """Messages of one camera that looks at one depth image all the time."""

    def __init__(self, counts: np.ndarray, camera: dict[str, Any], store: Typestore) -> None:
        self.counts = counts
        self.camera = camera
        self.store = store
        self.ros1 = "std_msgs/msg/Header" in store.fielddefs and any(
            name == "seq" for name, _ in store.fielddefs["std_msgs/msg/Header"][1]
        )

    def make(self, name: str, **fields: Any) -> Any:
        return self.store.types[name](**fields)

    def header(self, time_ns: int, frame_id: str = FRAME) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=time_ns // 10**9, nanosec=time_ns % 10**9)
        return self.make("std_msgs/msg/Header", **({"seq": 0} if self.ros1 else {}), stamp=stamp, frame_id=frame_id)

    def info(self, time_ns: int) -> Any:
        camera = self.camera
        roi = self.make("sensor_msgs/msg/RegionOfInterest",
                        x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)  # fmt: skip
        k = np.array([camera["fx"], 0, camera["cx"], 0, camera["fy"], camera["cy"], 0, 0, 1], np.float64)
        names = ("D", "K", "R", "P") if self.ros1 else ("d", "k", "r", "p")
        matrices = dict(zip(names, (np.zeros(5), k, np.eye(3).ravel(), np.zeros(12)), strict=True))
        return self.make(
            "sensor_msgs/msg/CameraInfo", header=self.header(time_ns), height=camera["height"], width=camera["width"],
            distortion_model="plumb_bob", binning_x=0, binning_y=0, roi=roi, **matrices,
        )  # fmt: skip

    def image(self, time_ns: int, encoding: str = "16UC1", padding: int = 0, big_endian: bool = False) -> Any:
        """Rows may be longer than the image is wide, and of either byte order."""
        pixels = self.counts if encoding == "16UC1" else np.where(self.counts, self.counts / 1000.0, np.nan)
        kind = (">" if big_endian else "<") + ("u2" if encoding == "16UC1" else "f4")
        rows = np.ascontiguousarray(pixels.astype(kind)).view(np.uint8).reshape(len(pixels), -1)
        rows = np.hstack([rows, np.full((len(rows), padding), 7, np.uint8)])
        return self.make(
            "sensor_msgs/msg/Image", header=self.header(time_ns), height=len(rows), width=self.counts.shape[1],
            encoding=encoding, is_bigendian=int(big_endian), step=rows.shape[1], data=rows.ravel(),
        )  # fmt: skip

    def compressed(self, time_ns: int, kind: str = "png") -> Any:
        header = struct.pack("<iff", 0, 0.0, 0.0)
        if kind == "rvl":
            data = header + struct.pack("<II", *self.counts.shape[::-1]) + encode_rvl(self.counts.ravel())
        else:
            data = header + cv2.imencode(".png", self.counts)[1].tobytes()
        return self.make(
            "sensor_msgs/msg/CompressedImage", header=self.header(time_ns),
            format="16UC1; compressedDepth" + (" rvl" if kind == "rvl" else ""), data=np.frombuffer(data, np.uint8),
        )  # fmt: skip

    def transforms(self, time_ns: int) -> Any:
        """base_link → mast (turned about z) → camera (z forward, 30° down)."""
        def transform(parent: str, child: str, quaternion: tuple[float, ...]) -> Any:
            x, y, z, w = quaternion
            return self.make(
                "geometry_msgs/msg/TransformStamped", header=self.header(time_ns, parent), child_frame_id=child,
                transform=self.make(
                    "geometry_msgs/msg/Transform",
                    translation=self.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=1.0),
                    rotation=self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
                ),
            )  # fmt: skip

        # From level (x right, y down, z forward seen from z up: a turn of −90° about x), then 30° further down.
        half = np.radians(-90.0 - 30.0) / 2
        mast = (0.0, 0.0, np.sin(0.4), np.cos(0.4))
        return self.make("tf2_msgs/msg/TFMessage", transforms=[
            transform("base_link", "mast", mast), transform("mast", FRAME, (np.sin(half), 0.0, 0.0, np.cos(half))),
        ])  # fmt: skip


def messages(scene: Scene, frames: int, kind: str) -> Iterator[Message]:
    """Transforms and CameraInfo once, then depth images, of one kind or compressed."""
    yield "/tf_static", START_NS, scene.transforms(START_NS)
    yield INFO, START_NS, scene.info(START_NS)
    for number in range(frames):
        time_ns = START_NS + (number + 1) * PERIOD_NS
        if kind in ("png", "rvl"):
            yield COMPRESSED, time_ns, scene.compressed(time_ns, kind)
        else:
            yield DEPTH, time_ns, scene.image(time_ns, kind)


def store_of(form: str) -> Typestore:
    if form not in ("ros1", "mcap-ros1"):
        return get_typestore(Stores.ROS2_HUMBLE)
    store = get_typestore(Stores.ROS1_NOETIC)
    name = "tf2_msgs/msg/TFMessage"
    if name not in store.fielddefs:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    return store


def write_bag(
    folder: Path, form: str, counts: np.ndarray, camera: dict[str, Any], frames: int = 3, kind: str = "16UC1"
) -> Path:
    """A recording of one of the forms `ros1`, `ros2`, `ros2-mcap`, `mcap` and `mcap-ros1`; returns its path."""
    store = store_of(form)
    scene = Scene(counts, camera, store)
    serialise = store.serialize_ros1 if scene.ros1 else store.serialize_cdr
    path = folder / {"ros1": "x.bag", "mcap": "x.mcap", "mcap-ros1": "x.mcap"}.get(form, "x")
    if form.startswith("mcap"):
        _write_mcap(path, scene, serialise, messages(scene, frames, kind))
        return path
    plugin = StoragePlugin.MCAP if form == "ros2-mcap" else StoragePlugin.SQLITE3
    with Writer1(path) if form == "ros1" else Writer2(path, version=9, storage_plugin=plugin) as writer:
        connections: dict[str, Any] = {}
        for topic, time_ns, message in messages(scene, frames, kind):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, message.__msgtype__, typestore=store)
            writer.write(connections[topic], time_ns, serialise(message, message.__msgtype__))
    return path


def _write_mcap(path: Path, scene: Scene, serialise: Any, found: Iterator[Message]) -> None:
    """As Foxglove's bridge records: one file and no folder, schemas as text inside."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile="ros1" if scene.ros1 else "ros2")
        channels: dict[str, int] = {}
        for topic, time_ns, message in found:
            name = message.__msgtype__
            if topic not in channels:
                text, _ = scene.store.generate_msgdef(name, ros_version=1 if scene.ros1 else 2)
                schema = writer.register_schema(
                    name.replace("/msg/", "/") if scene.ros1 else name, "ros1msg" if scene.ros1 else "ros2msg",
                    text.encode(),
                )  # fmt: skip
                channels[topic] = writer.register_channel(topic, "ros1" if scene.ros1 else "cdr", schema)
            writer.add_message(channels[topic], time_ns, bytes(serialise(message, name)), time_ns)
        writer.finish()
