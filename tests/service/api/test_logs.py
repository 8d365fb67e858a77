"""Log lines that a machine reads: one object a line, with the request they belong to."""

from __future__ import annotations

import io
import json
import logging
from datetime import datetime

import grpc
import httpx
import pytest

from service.api.logs import configure
from tests.service import rpc_client
from tests.service.box_scene import BoxScene
from tests.service.fakes import FakePredictor, running

SCENE = BoxScene(width=32, height=24, focal_px=30.0)


@pytest.fixture
def written() -> io.StringIO:
    """What is logged as JSON at `debug`."""
    stream = io.StringIO()
    configure("debug", "json", stream)
    return stream


def lines(written: io.StringIO) -> list[dict]:
    return [json.loads(line) for line in written.getvalue().splitlines()]


def react(request) -> None:
    if request.material.young_modulus_pa == 666.0:
        raise RuntimeError("a bug\nwith a line break")


def test_every_request_leaves_a_line_with_its_id_on_either_wire(written):
    bad = SCENE.request(material={"young_modulus_pa": 666.0, "poisson_ratio": 0.3})
    with running(FakePredictor(react)) as service, grpc.insecure_channel(service.grpc) as channel:
        httpx.post(f"{service.url}/v1/deform", json=SCENE.request(), headers={"X-Request-Id": "good/1"})
        httpx.post(f"{service.url}/v1/deform", json={}, headers={"X-Request-Id": "refused/2"})
        httpx.post(f"{service.url}/v1/deform", json=bad, headers={"X-Request-Id": "failed/3"})
        stub = rpc_client.stub(channel)
        stub.Deform(rpc_client.message(SCENE.request()), metadata=(("x-request-id", "call/4"),))
    by_id: dict[str, list[dict]] = {}
    for line in lines(written):
        assert {"time", "level", "logger", "message"} <= set(line)
        assert datetime.fromisoformat(line["time"]).utcoffset() is not None
        if "request_id" in line:
            by_id.setdefault(line["request_id"], []).append(line)
    (good,) = by_id["good/1"]
    assert (good["level"], good["wire"], good["route"], good["code"]) == ("debug", "http", "/v1/deform", "ok")
    assert good["duration_ms"] > 0.0
    refusal, done = by_id["refused/2"]
    assert (refusal["level"], refusal["code"], refusal["field"]) == ("info", "invalid_request", "material")
    assert done["code"] == "invalid_request"
    failure, done = by_id["failed/3"]
    assert (failure["level"], failure["code"]) == ("error", "internal")
    assert "a bug\nwith a line break" in failure["exception"]
    assert (by_id["call/4"][0]["wire"], by_id["call/4"][0]["code"]) == ("grpc", "ok")
    # Nothing is traced, so no line speaks of a trace.
    assert not [line for line in lines(written) if "trace_id" in line]


def test_what_json_cannot_say_is_said_as_text(written):
    logging.getLogger("elsewhere").warning("at %s", "λ", extra={"path": pytest, "count": 3, "nothing": None})
    (line,) = [line for line in lines(written) if line["logger"] == "elsewhere"]
    assert (line["message"], line["count"]) == ("at λ", 3)
    assert "nothing" not in line and "pytest" in line["path"]
