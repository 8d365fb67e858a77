"""`physnet replay` from a recording to a recording, with a predictor without networks."""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="recordings need rosbags: pip install 'physnet[replay]'")

from foxglove_schemas_protobuf.PointCloud_pb2 import PointCloud
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from foxglove_schemas_protobuf.VoxelGrid_pb2 import VoxelGrid
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from service.__main__ import main
from service.client import Answer, Camera, Push
from service.client.frames import FrameBook
from service.client.ros import rotation_of
from service.client.stream import FrameStream, carry_by_calls
from service.commands.exits import OK, REFUSED, USAGE
from service.core.errors import NoSupportPlane
from service.replay.embedded import EmbeddedClient
from service.replay.force import Force, force_of
from service.replay.foxglove import quaternion_of, scene, voxel_grid
from service.replay.frames import RecordedFrame
from service.replay.player import Summary, paced, play
from service.replay.progress import line, report
from service.settings import Settings
from tests.poses import pose
from tests.service.box_scene import BoxScene
from tests.service.client.answers import answer
from tests.service.fakes import FakePredictor, fake_result, running
from tests.service.replay.bags import FRAME, PERIOD_NS, START_NS, UP, write_bag
from tests.service.screen import Screen

SCENE = BoxScene(width=64, height=48, focal_px=60.0)
PUSH = ["--material", "silicone", "--press", "31,20", "--force", "-1,0,2.5"]


@pytest.fixture
def bag(tmp_path) -> str:
    return str(write_bag(tmp_path, "ros2", SCENE.counts(), SCENE.camera, frames=4, kind="rvl"))


def read_mcap(path) -> dict[str, list[Any]]:
    """Messages of each topic, decoded by the schemas in the file itself."""
    found: dict[str, list[Any]] = {}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for schema, channel, message in reader.iter_messages():
            decoder = DecoderFactory().decoder_for(channel.message_encoding, schema)
            decoded = decoder(message.data) if decoder else json.loads(message.data)
            found.setdefault(channel.topic, []).append((message.log_time, decoded))
    return found


@pytest.mark.parametrize("wire", ["grpc", "http"])
def test_a_recording_is_played_to_a_service_and_written_for_foxglove(bag, tmp_path, capsys, wire):
    out = tmp_path / "out.mcap"
    with running(FakePredictor()) as service:
        url = f"grpc://{service.grpc}" if wire == "grpc" else service.url
        options = ["--server", url, "--up-frame", "base_link", "-o", str(out), "--rate", "0", "--json"]
        assert main(["replay", bag, *PUSH, *options]) == OK
    report = json.loads(capsys.readouterr().out)
    assert (report["frames"], report["answered"], report["skipped"], report["failed"]) == (4, 4, 0, 0)
    assert report["recorded_s"] == pytest.approx(3e-9 * PERIOD_NS)
    assert 0.0 < report["round_trip_ms"]["p50"] <= report["round_trip_ms"]["p99"]
    for asked in service.predictor.asked:
        assert asked.source.depth.encoding == "16UC1; compressedDepth rvl"
        assert asked.loads[0].contact_px == (31.0, 20.0)
        np.testing.assert_array_equal(asked.loads[0].force_n, [-1.0, 0.0, 2.5])
        np.testing.assert_allclose(asked.source.up, UP, atol=1e-9)
    found = read_mcap(out)
    assert set(found) == {"/physnet/deformed", "/physnet/points", "/physnet/scene", "/physnet/answer"}
    want = fake_result(asked)
    for times in found.values():
        assert [time_ns for time_ns, _ in times] == [START_NS + n * PERIOD_NS for n in (1, 2, 3, 4)]
    grid: VoxelGrid = found["/physnet/deformed"][0][1]
    assert (grid.DESCRIPTOR.full_name, grid.frame_id) == ("foxglove.VoxelGrid", FRAME)
    cells = np.frombuffer(grid.data, np.uint8).reshape(64, 64, 64, 4)
    np.testing.assert_array_equal(cells[..., 3].transpose(2, 1, 0) > 0, want.loads[0].deformed)
    cloud: PointCloud = found["/physnet/points"][0][1]
    rows = np.frombuffer(cloud.data, "<f4").reshape(-1, 4)
    centres = (np.argwhere(want.loads[0].deformed) + 0.5) * want.grid.pitch_m + want.grid.camera_from_grid[:3, 3]
    np.testing.assert_allclose(rows[:, :3], centres, atol=1e-6)
    np.testing.assert_allclose(rows[:, 3], 0.003, rtol=1e-3)
    update: SceneUpdate = found["/physnet/scene"][0][1]
    assert len(update.entities[0].triangles) == 2
    assert len(update.entities[0].arrows) == 1
    assert found["/physnet/answer"][0][1]["max_displacement_m"] == 0.003


@pytest.fixture
def embedded(monkeypatch) -> FakePredictor:
    predictor = FakePredictor()
    real = EmbeddedClient.__init__
    monkeypatch.setattr(EmbeddedClient, "__init__", lambda self, settings: real(self, settings, predictor))
    return predictor


def test_without_a_service_the_models_of_this_machine_answer(bag, embedded, capsys):
    assert main(["replay", bag, *PUSH, "--limit", "2", "--rate", "0"]) == OK
    assert len(embedded.asked) == 2
    out = capsys.readouterr().out
    assert "answered    2" in out
    assert "p50" in out


def test_what_goes_wrong_has_its_exit_code(bag, embedded, tmp_path, capsys):
    assert main(["replay", str(tmp_path / "none.bag"), *PUSH]) == USAGE
    assert main(["replay", bag, *PUSH, "-o", str(tmp_path / "none" / "x.mcap")]) == USAGE
    assert "--output: there is no folder" in capsys.readouterr().err
    assert main(["replay", bag, *PUSH, "--rate", "-1"]) == USAGE
    assert main(["replay", bag, *PUSH, "--depth", "/none"]) == USAGE
    assert main(["replay", bag, *PUSH, "--server", "nowhere"]) == USAGE
    assert main(["replay", bag, "--material", "silicone", "--press", "31", "--force", "1"]) == USAGE
    assert main(["replay", bag, *PUSH, "--limit", "0"]) == USAGE
    capsys.readouterr()

    def refuse(_: Any) -> None:
        raise NoSupportPlane("No plane is visible.", field="up")

    embedded.react = refuse
    assert main(["replay", bag, *PUSH, "--rate", "0"]) == REFUSED
    assert "no_support_plane" in capsys.readouterr().out


def frame(number: int) -> RecordedFrame:
    from service.client import Image

    time_ns = START_NS + number * PERIOD_NS
    depth = Image("16UC1", SCENE.counts().tobytes())
    return RecordedFrame(time_ns, time_ns, FRAME, depth, Camera.from_json(SCENE.camera), None)


def test_frames_come_at_their_own_pace_and_late_ones_are_not_waited_for():
    now = [100.0]
    slept: list[float] = []

    def sleep(seconds: float) -> None:
        slept.append(seconds)
        now[0] += seconds

    for taken in paced((frame(number) for number in range(4)), 2.0, sleep, lambda: now[0]):
        if taken.time_ns == START_NS + PERIOD_NS:
            now[0] += 0.06  # longer than until the third, which is due at 0.05 s
    # The third and the fourth are late, and come at once.
    assert slept == pytest.approx([0.025])
    assert now[0] == pytest.approx(100.085)


def test_a_slow_predictor_skips_frames_and_all_are_counted():
    import threading

    from service.client import question

    last_sent = threading.Event()

    def slow(_: Any) -> Any:
        # The first is held until all others were sent, so only the newest of them is left.
        assert last_sent.wait(20)
        return answer()

    def frames() -> Any:
        for number in range(6):
            yield frame(number)
            if number == 0:
                while stream._book.waits:
                    pass
        last_sent.set()

    stream = FrameStream(carry_by_calls(slow), FrameBook(8, 1000, True))
    played: list[Any] = []
    shown: list[str] = []
    summary = play(
        frames(), lambda one: question(one.depth, one.camera, Push((0, 0, 1), contact_px=(31, 20))), stream,
        played.append, lambda now: shown.append(line(now)),
    )  # fmt: skip
    assert (summary.sent, summary.answered, summary.skipped) == (6, 2, 4)
    answered = [one for one in played if one.answer.result is not None]
    assert [one.frame for one in answered] == [frame(0), frame(5)]
    assert "answered 2" in shown[-1] and "skipped 4" in shown[-1]
    text = report(summary)
    assert "frames      6" in text and "from frame to answer" in text


def test_a_summary_of_nothing_has_no_latency():
    summary = Summary()
    summary.count(Answer(0, error=NoSupportPlane("No plane.")))
    assert math.isnan(summary.percentile_ms(50.0))
    assert "1 times: No plane." in report(summary)
    assert "p50 –" in line(summary)


def test_a_line_tells_where_things_stand():
    summary = Summary(sent=3, answered=2, skipped=1, recorded_s=0.1, played_s=0.4, round_trip_ms=[20.0, 40.0])
    assert line(summary) == "    0.1 s  frames 3  answered 2 (5.0/s)  skipped 1  failed 0  p50 30 ms"


def test_a_terminal_sees_a_recording_play(bag, embedded, monkeypatch):
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("COLUMNS", "40")
    assert main(["replay", bag, *PUSH, "--rate", "0"]) == OK
    first, *_, last = screen.getvalue().split("\r\x1b[K")[1:]
    assert re.fullmatch(r"[━─]{10}    \d\.\d s  frames \d+  answered", first)
    assert last == ""
    screen.truncate(0)
    assert main(["replay", bag, *PUSH, "--limit", "1", "--rate", "0"]) == OK
    assert "frames 1" in screen.getvalue() and "─" not in screen.getvalue()


@pytest.mark.parametrize(
    "angles", [(0.0, 0.0, 0.0), (0.4, -0.2, 0.9), (np.pi, 0.0, 0.0), (0.0, np.pi, 1.0), (3.1, 3.1, 3.1)]
)
def test_a_rotation_is_its_quaternion(angles):
    from types import SimpleNamespace

    rotation = pose(angles)[:3, :3]
    x, y, z, w = quaternion_of(rotation)
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0)
    np.testing.assert_allclose(rotation_of(SimpleNamespace(x=x, y=y, z=z, w=w)), rotation, atol=1e-9)


def test_the_scene_stands_where_the_body_is():
    from google.protobuf.timestamp_pb2 import Timestamp

    result, stamp = answer(), Timestamp(seconds=1)
    grid = voxel_grid(result, stamp, FRAME)
    orientation, position = grid.pose.orientation, grid.pose.position
    deformed = np.frombuffer(grid.data, np.uint8).reshape(64, 64, 64, 4)[..., 3] > 0
    z, y, x = np.nonzero(deformed)
    corners = np.column_stack([x, y, z]) * grid.cell_size.x + grid.cell_size.x / 2
    centres = corners @ rotation_of(orientation).T + (position.x, position.y, position.z)
    np.testing.assert_allclose(centres.mean(0), result.points_camera().mean(0), atol=1e-6)

    force = Force(np.array([0.05, 0.0, 0.7]), np.array([0.0, 3.0, 4.0]))
    (arrow,) = scene(result, stamp, FRAME, force).entities[0].arrows
    tip = rotation_of(arrow.pose.orientation) @ [arrow.shaft_length + arrow.head_length, 0.0, 0.0]
    start = np.array([arrow.pose.position.x, arrow.pose.position.y, arrow.pose.position.z])
    np.testing.assert_allclose(start + tip, force.contact_m, atol=1e-9)
    np.testing.assert_allclose(tip / np.linalg.norm(tip), [0.0, 0.6, 0.8], atol=1e-9)
    # Without a force there is no arrow, and none is drawn for one that attacks nobody knows where.
    assert not scene(result, stamp, FRAME, None).entities[0].arrows


def test_the_place_of_a_push_is_looked_up_in_its_image():
    one = frame(0)
    u, v = SCENE.pixel(SCENE.front_m())
    found = force_of(Push((0, 0, 1), contact_px=(u, v)), one.depth, one.camera)
    np.testing.assert_allclose(found.contact_m, SCENE.in_camera(SCENE.front_m()), atol=0.02)
    assert force_of(Push((0, 0, 1), contact_px=(-5, 3)), one.depth, one.camera) is None
    known = force_of(Push((0, 0, 1), contact_m=(1, 2, 3)), one.depth, one.camera)
    np.testing.assert_array_equal(known.contact_m, [1, 2, 3])


def test_the_embedded_predictor_refuses_in_the_services_words():
    from service.client import InvalidRequest, question

    client = EmbeddedClient(Settings(max_loads=1), FakePredictor())
    one = frame(0)
    with pytest.raises(InvalidRequest) as caught:
        client.ask(question(one.depth, one.camera, [Push((0, 0, 1), contact_px=(1, 1))] * 2))
    assert caught.value.field == "loads"


def test_a_rerun_recording_is_written_on_request(bag, embedded, tmp_path):
    pytest.importorskip("rerun", reason="rerun-sdk is not installed: pip install 'physnet[rerun]'")
    out = tmp_path / "out.rrd"
    assert main(["replay", bag, *PUSH, "--limit", "2", "--rate", "0", "--rerun", str(out)]) == OK
    tool = [sys.executable, "-m", "rerun", "rrd"]
    subprocess.run([*tool, "verify", str(out)], check=True, capture_output=True, timeout=60)
    chunks = subprocess.run([*tool, "print", str(out)], check=True, capture_output=True, text=True, timeout=60).stdout
    logged = {
        "/camera/image": "Pinhole:image_from_camera", "/camera/image/depth": "DepthImage:buffer",
        "/camera/reconstruction": "Mesh3D:vertex_positions", "/camera/deformed": "Mesh3D:vertex_colors",
        "/camera/voxels": "Points3D:positions", "/camera/force": "Arrows3D:vectors",
        "/figures/round_trip_ms": "Scalars:scalars", "/flags": "TextLog:text",
    }  # fmt: skip
    for path, column in logged.items():
        assert any(f" - {path} - " in line and column in line for line in chunks.splitlines()), f"{path}\n{chunks}"
