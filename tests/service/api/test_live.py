"""`/v1/live` over a real socket."""

from __future__ import annotations

import json
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pytest
from websockets.exceptions import ConnectionClosed, InvalidStatus
from websockets.sync.client import ClientConnection, connect

from service.core.errors import ReconstructionGone
from service.core.messages import DeformRequest, DeformResult, EarlierReconstruction, Observation
from tests.service.box_scene import BoxScene
from tests.service.fakes import FakePredictor, Running, fake_result, running

SCENE = BoxScene(width=32, height=24, focal_px=30.0)
MATERIAL = {"young_modulus_pa": 1e5, "poisson_ratio": 0.45}


@dataclass
class Keeping(FakePredictor):
    """A predictor that keeps its reconstructions until they are forgotten."""

    kept: set[str] = field(default_factory=set)

    def predict(self, request: DeformRequest) -> DeformResult:
        result = super().predict(request)
        if not isinstance(request.source, EarlierReconstruction):
            self.kept.add(name := f"r{len(self.asked)}")
            return replace(result, reconstruction_id=name)
        if request.source.reconstruction_id not in self.kept:
            raise ReconstructionGone("gone", field="reconstruction_id")
        return replace(result, reconstruction_id=request.source.reconstruction_id)


def message(head: dict[str, Any], *parts: bytes) -> bytes:
    text = json.dumps(head).encode()
    return struct.pack("<I", len(text)) + text + b"".join(parts)


def opening(frame: int = 1, **changes: Any) -> bytes:
    """A frame with its depth as a part."""
    depth = SCENE.depth_png()
    request = SCENE.request(depth={"encoding": "png16"}, **changes)
    return message({"frame": frame, "request": request, "parts": {"depth": len(depth)}}, depth)


def push(frame: int, force_n: float = 1.0, **changes: Any) -> str:
    loads = [{"contact_m": [0.0, 0.0, 0.6], "force_n": [0.0, 0.0, force_n]}]
    return json.dumps({"frame": frame, "push": {"material": MATERIAL, "loads": loads} | changes})


def parts_of(data: bytes | str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Head and parts of an answer."""
    assert isinstance(data, bytes), data
    (length,) = struct.unpack_from("<I", data)
    head = json.loads(data[4 : 4 + length])
    assert (4 + length) % 8 == 0
    parts = {}
    for name, part in head["parts"].items():
        count = int(np.prod(part["shape"]))
        found = np.frombuffer(data, part["dtype"], count, 4 + length + part["offset"])
        parts[name] = found.reshape(part["shape"])
    return head, parts


@pytest.fixture(scope="module")
def service() -> Iterator[Running]:
    """For tests that leave nothing behind."""
    with running(Keeping()) as service:
        yield service


def join(service: Running) -> ClientConnection:
    return connect(f"{service.url.replace('http', 'ws')}/v1/live", max_size=None)


@contextmanager
def connected(predictor: FakePredictor | None = None, **settings: Any) -> Iterator[tuple[ClientConnection, Running]]:
    with running(predictor or Keeping(), **settings) as service, join(service) as socket:
        yield socket, service


def test_the_first_answer_brings_the_body_and_later_ones_only_the_displacement():
    predictor = Keeping()
    with connected(predictor) as (socket, _):
        socket.send(opening())
        first, parts = parts_of(socket.recv(timeout=10))
        assert (first["frame"], first["body"]) == (1, 1)
        assert set(parts) == {"rest", "observed", "displacement"}
        socket.send(push(2, force_n=3.0))
        second, parts = parts_of(socket.recv(timeout=10))
        assert (second["frame"], second["body"]) == (2, 1)
        assert set(parts) == {"displacement"}
    assert isinstance(predictor.asked[0].source, Observation)
    assert predictor.asked[0].source.depth.data == SCENE.depth_png()
    assert predictor.asked[1].source == EarlierReconstruction("r1")
    assert predictor.asked[1].loads[0].force_n.tolist() == [0.0, 0.0, 3.0]


def test_the_parts_are_the_result():
    predictor = Keeping()
    with connected(predictor) as (socket, _):
        socket.send(opening())
        head, parts = parts_of(socket.recv(timeout=10))
    expected = fake_result(predictor.asked[0])
    assert head["grid"]["voxel_size_m"] == expected.grid.pitch_m
    assert head["max_displacement_m"] == pytest.approx(0.003)
    assert head["flags"] == ["contact_snapped", "object_cut_by_border"]
    box = head["parts"]["rest"]
    x, y, z = (slice(low, low + side) for low, side in zip(box["origin"], box["shape"], strict=True))
    rest = parts["rest"] > 255 * head["threshold"]
    whole = np.zeros((64, 64, 64), bool)
    whole[x, y, z] = rest
    assert (whole == expected.reconstruction).all()
    observed = np.unpackbits(parts["observed"], bitorder="little").reshape(64, 64, 64).astype(bool)
    assert (observed == expected.observed).all()
    displacement = parts["displacement"].astype(float)
    displacement[parts["displacement"] == np.iinfo(np.int16).min] = np.nan
    along_x = displacement[0] * head["parts"]["displacement"]["scale"]
    assert np.nanmin(along_x) == pytest.approx(0.003, rel=1e-4)
    assert np.nanmax(along_x) == pytest.approx(0.003, rel=1e-4)
    assert np.nanmax(np.abs(displacement[1:])) == 0.0
    assert head["timing_ms"]["total"] >= head["timing_ms"]["encode"] > 0.0


def test_an_image_may_come_as_base64_too(service):
    with join(service) as socket:
        socket.send(json.dumps({"frame": 1, "request": SCENE.request()}))
        assert parts_of(socket.recv(timeout=10))[0]["frame"] == 1


def test_a_reconstruction_that_is_gone_is_made_again():
    predictor = Keeping()
    with connected(predictor) as (socket, _):
        socket.send(opening())
        socket.recv(timeout=10)
        predictor.kept.clear()
        socket.send(push(2))
        head, parts = parts_of(socket.recv(timeout=10))
        assert head["frame"] == 2
        assert "rest" in parts
    kinds = [type(request.source) for request in predictor.asked]
    assert kinds == [Observation, EarlierReconstruction, Observation]


def test_the_object_is_looked_for_again_on_request():
    predictor = Keeping()
    with connected(predictor) as (socket, _):
        socket.send(opening())
        socket.recv(timeout=10)
        socket.send(push(2, reconstruct=True))
        head, parts = parts_of(socket.recv(timeout=10))
    assert (head["body"], "rest" in parts) == (2, True)
    assert isinstance(predictor.asked[1].source, Observation)


def test_the_newest_push_wins_and_those_it_overtakes_hear_of_it():
    entered, gate = threading.Event(), threading.Event()

    def hold(_: DeformRequest) -> None:
        entered.set()
        assert gate.wait(10)

    with connected(Keeping(hold)) as (socket, _):
        socket.send(opening())
        assert entered.wait(10)
        for frame in (2, 3, 4):
            socket.send(push(frame))
        skipped = [json.loads(socket.recv(timeout=10)) for _ in range(2)]
        gate.set()
        answers = [parts_of(socket.recv(timeout=10))[0]["frame"] for _ in range(2)]
    assert skipped == [{"frame": 2, "skipped": {"overtaken_by": 3}}, {"frame": 3, "skipped": {"overtaken_by": 4}}]
    assert answers == [1, 4]


@pytest.mark.parametrize(
    ("sent", "code", "field"),
    [
        (push(9), "invalid_request", "push"),
        (json.dumps({"frame": 9}), "invalid_request", "request"),
        (json.dumps({"frame": 9, "sound": True}), "invalid_request", "sound"),
        ("{", "invalid_request", None),
        (b"\x01", "invalid_request", "head_length"),
        (b"\xff\xff\xff\xff{}", "invalid_request", "head_length"),
        (message({"frame": 9, "request": SCENE.request(), "parts": {"depth": 4}}, b"abc"), "invalid_request", "parts"),
        (message({"frame": 9, "request": SCENE.request(), "parts": {"smell": 3}}, b"abc"), "invalid_request", "parts"),
        (opening(9, material={"name": "unobtainium"}), "unknown_material", "material.name"),
        (opening(9, loads=[]), "invalid_request", "request.loads"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_said_and_the_connection_goes_on(service, sent, code, field):
    with join(service) as socket:
        socket.send(sent)
        reply = json.loads(socket.recv(timeout=10))
        assert reply["problem"]["code"] == code
        assert reply["problem"].get("field") == field
        assert reply["problem"]["detail"]
        socket.send(opening(10))
        assert parts_of(socket.recv(timeout=10))[0]["frame"] == 10


def test_messages_are_numbered_upwards(service):
    with join(service) as socket:
        socket.send(opening(5))
        socket.recv(timeout=10)
        socket.send(push(5))
        problem = json.loads(socket.recv(timeout=10))["problem"]
    assert (problem["field"], problem["expected"], problem["actual"]) == ("frame", "> 5", "5")


def test_a_token_comes_in_the_first_head():
    with connected(token="secret") as (socket, _):
        socket.send(json.dumps({"frame": 1, "request": SCENE.request(), "token": "wrong"}))
        assert json.loads(socket.recv(timeout=10))["problem"]["code"] == "unauthenticated"
        socket.send(json.dumps({"frame": 2, "request": SCENE.request(), "token": "secret"}))
        assert parts_of(socket.recv(timeout=10))[0]["frame"] == 2
        socket.send(push(3))
        assert parts_of(socket.recv(timeout=10))[0]["frame"] == 3


def test_pages_from_elsewhere_are_refused(service):
    url = f"{service.url.replace('http', 'ws')}/v1/live"
    with pytest.raises(InvalidStatus):
        connect(url, origin="https://elsewhere.example")  # type: ignore[arg-type]
    with connect(url, origin=service.url) as socket:  # type: ignore[arg-type]
        socket.send(opening())
        assert isinstance(socket.recv(timeout=10), bytes)


def test_the_end_of_the_service_ends_the_connection():
    with connected() as (socket, service):
        socket.send(opening())
        socket.recv(timeout=10)
        assert service.stop() == 0
        with pytest.raises(ConnectionClosed):
            socket.recv(timeout=10)
