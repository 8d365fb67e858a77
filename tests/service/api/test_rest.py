"""The HTTP wire over a real socket, around a predictor without networks."""

from __future__ import annotations

import http.client
import io
import json
import re
import socket
import threading
import time
from collections.abc import Iterator

import httpx
import numpy as np
import pytest

from service.core.errors import ContactOffBody
from service.core.materials import MATERIALS
from tests.service.box_scene import BoxScene, grid
from tests.service.fakes import FakePredictor, Running, running
from tests.service.waiting import queue_depth, until

SCENE = BoxScene(width=64, height=48, focal_px=60.0)


def react(request) -> None:
    if request.material.young_modulus_pa == 666.0:
        raise RuntimeError("a bug that knows /etc/passwd")
    if request.material.young_modulus_pa == 404.0:
        raise ContactOffBody("Too far.", field="loads[0].contact_m", expected=0.02, actual=0.5)


@pytest.fixture(scope="module")
def service() -> Iterator[Running]:
    with running(FakePredictor(react), max_body_bytes=100_000, max_loads=4) as service:
        yield service


@pytest.fixture
def client(service: Running) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=service.url, timeout=10) as client:
        yield client


def problem(reply: httpx.Response, status: int, code: str) -> dict:
    assert reply.status_code == status, reply.text
    assert reply.headers["content-type"] == "application/problem+json"
    document = reply.json()
    assert (document["code"], document["status"]) == (code, status)
    assert document["request_id"] == reply.headers["x-request-id"]
    assert "Traceback" not in reply.text
    return document


def counter(client: httpx.Client, code: str) -> float:
    lines = client.get("/metrics").text.splitlines()
    name = f'physnet_requests_total{{code="{code}",route="/v1/deform",wire="http"}}'
    return sum(float(line.split()[-1]) for line in lines if line.startswith(name))


def test_json_in_json_out(client):
    reply = client.post("/v1/deform", json=SCENE.request())
    assert reply.status_code == 200
    document = reply.json()
    assert grid(document["reconstruction"]).sum() > 1000
    np.testing.assert_array_equal(
        grid(document["loads"][0]["deformed"]), np.roll(grid(document["reconstruction"]), 1, axis=0)
    )
    assert document["timing_ms"]["decode"] == 1.0
    assert document["timing_ms"]["total"] > 0
    assert list(document["timing_ms"])[-1] == "total"
    assert document["model"] == {"name": "fake", "version": "9.9.9"}


@pytest.mark.parametrize("filename", [None, "request.json"])
def test_multipart_gives_the_same_answer_as_json(client, service, filename):
    as_json = client.post("/v1/deform", json=SCENE.request(mask={"data": "bWFzaw=="})).json()
    first = service.predictor.asked[-1]
    body = SCENE.request(depth={"encoding": "png16", "unit_m": 0.001})
    parts = {
        "request": (filename, json.dumps(body), "application/json"),
        "depth": ("depth.png", SCENE.depth_png(), "image/png"),
        "mask": ("mask.png", b"mask", "image/png"),
    }
    as_parts = client.post("/v1/deform", files=parts).json()
    second = service.predictor.asked[-1]
    assert second.source.depth == first.source.depth
    assert second.source.mask == first.source.mask
    for document in (as_json, as_parts):
        del document["request_id"], document["timing_ms"]
    assert as_parts == as_json


def test_the_archive_is_asked_for_by_accept(client):
    reply = client.post("/v1/deform", json=SCENE.request(), headers={"Accept": "application/x-npz"})
    assert reply.headers["content-type"] == "application/x-npz"
    with np.load(io.BytesIO(reply.content)) as archive:
        assert archive["deformed"].shape == (1, 64, 64, 64)


@pytest.mark.parametrize(
    ("accept", "kind"),
    [
        ("*/*", "application/json"),
        ("text/html, application/*;q=0.5", "application/json"),
        ("application/x-npz;q=0.4, application/json;q=0.6", "application/json"),
        ("application/json;q=0.4, application/x-npz", "application/x-npz"),
    ],
)
def test_the_reply_is_of_the_kind_most_wanted(client, accept, kind):
    reply = client.post("/v1/deform", json=SCENE.request(), headers={"Accept": accept})
    assert reply.headers["content-type"] == kind


def test_a_kind_that_is_not_written_is_refused(client):
    reply = client.post("/v1/deform", json=SCENE.request(), headers={"Accept": "model/stl"})
    assert problem(reply, 400, "invalid_request")["field"] == "Accept"


def test_a_body_of_an_unknown_kind_is_refused(client):
    reply = client.post("/v1/deform", content=b"x=1", headers={"Content-Type": "text/plain"})
    assert problem(reply, 400, "invalid_request")["field"] == "Content-Type"


@pytest.mark.parametrize(
    ("content", "headers"),
    [
        (b"nothing like it", {"Content-Type": "multipart/form-data; boundary=x"}),
        (b"--x\r\n\r\n", {"Content-Type": "multipart/form-data"}),
        (b"--x\r\nbad header\r\n\r\nvalue\r\n--x--\r\n", {"Content-Type": "multipart/form-data; boundary=x"}),
    ],
)
def test_a_broken_multipart_body_is_refused(client, content, headers):
    problem(client.post("/v1/deform", content=content, headers=headers), 400, "invalid_request")


def test_parts_must_be_there_once_and_known(client):
    request = (None, json.dumps(SCENE.request(depth=...)), "application/json")
    depth = ("d.png", SCENE.depth_png(), "image/png")
    assert problem(client.post("/v1/deform", files={"depth": depth}), 400, "invalid_request")["field"] == "request"
    unknown = client.post("/v1/deform", files={"request": request, "depth": depth, "colour": depth})
    assert problem(unknown, 400, "invalid_request")["field"] == "colour"
    twice = client.post("/v1/deform", files=[("request", request), ("depth", depth), ("depth", depth)])
    assert problem(twice, 400, "invalid_request")["field"] == "depth"
    many = client.post("/v1/deform", files=[("request", request)] * 50)
    problem(many, 400, "invalid_request")


def test_an_error_of_the_pipeline_becomes_its_problem_document(client):
    reply = client.post("/v1/deform", json=SCENE.request(material={"young_modulus_pa": 404.0, "poisson_ratio": 0.3}))
    document = problem(reply, 422, "contact_off_body")
    assert (document["field"], document["expected"], document["actual"]) == ("loads[0].contact_m", 0.02, 0.5)


def test_a_bug_gives_nothing_away_and_costs_no_other_request(client, caplog):
    bad = SCENE.request(material={"young_modulus_pa": 666.0, "poisson_ratio": 0.3})
    before = counter(client, "internal")
    reply = client.post("/v1/deform", json=bad, headers={"X-Request-Id": "find-me"})
    assert "passwd" not in reply.text
    assert problem(reply, 500, "internal")["request_id"] == "find-me"
    assert any("find-me" in record.message and "passwd" in str(record.exc_info[1]) for record in caplog.records)
    assert counter(client, "internal") == before + 1
    assert client.post("/v1/deform", json=SCENE.request()).status_code == 200


def test_a_usable_request_id_is_kept_and_any_other_replaced(client):
    kept = client.post("/v1/deform", json=SCENE.request(), headers={"X-Request-Id": "robot-7/frame:12"})
    assert kept.headers["x-request-id"] == kept.json()["request_id"] == "robot-7/frame:12"
    for bad in ("a b", "x" * 129, "", "<script>"):
        reply = client.get("/healthz", headers={"X-Request-Id": bad})
        assert reply.headers["x-request-id"] != bad
        assert len(reply.headers["x-request-id"]) == 32


def test_a_body_that_says_it_is_too_large_is_refused(client):
    reply = client.post("/v1/deform", content=b"x" * 200_000, headers={"Content-Type": "application/json"})
    document = problem(reply, 413, "payload_too_large")
    assert document["actual"] == 200_000
    assert "100000" in document["expected"]


def test_a_body_that_does_not_say_its_length_is_counted_while_it_arrives(service):
    def endless():
        for _ in range(100):
            yield b"x" * 10_000

    for kind in ("application/json", "multipart/form-data; boundary=x"):
        reply = httpx.post(f"{service.url}/v1/deform", content=endless(), headers={"Content-Type": kind}, timeout=10)
        if kind == "application/json":
            problem(reply, 413, "payload_too_large")
        else:
            # The parser finds it is no multipart before it has become too large; both are right.
            assert reply.status_code in (400, 413)


def test_a_body_that_never_ends_is_given_up_at_the_deadline(service):
    host, port = service.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=10) as connection:
        connection.sendall(
            b"POST /v1/deform HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: 5000\r\n"
            b"X-Deadline-Ms: 200\r\n\r\n{"
        )
        began = time.monotonic()
        # head and body may come in two pieces
        reply = http.client.HTTPResponse(connection)
        reply.begin()
        problem = json.load(reply)
        assert time.monotonic() - began < 5.0
    assert reply.status == 504
    assert problem["code"] == "deadline_exceeded"


def test_a_client_that_vanishes_mid_frame_costs_nothing(client, service):
    host, port = service.url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=10) as connection:
        connection.sendall(
            b"POST /v1/deform HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\nContent-Length: 5000\r\n\r\n{"
        )
    assert client.post("/v1/deform", json=SCENE.request()).status_code == 200


@pytest.mark.parametrize("value", ["soon", "-1", "0", "nan", "inf"])
def test_a_deadline_must_be_a_number(client, value):
    reply = client.post("/v1/deform", json=SCENE.request(), headers={"X-Deadline-Ms": value})
    assert problem(reply, 400, "invalid_request")["field"] == "X-Deadline-Ms"


def test_a_deadline_already_past_computes_nothing(client, service):
    asked = len(service.predictor.asked)
    reply = client.post("/v1/deform", json=SCENE.request(), headers={"X-Deadline-Ms": "1e-6"})
    problem(reply, 504, "deadline_exceeded")
    assert len(service.predictor.asked) == asked


def test_too_many_loads(client):
    body = SCENE.request()
    body["loads"] *= 5
    assert problem(client.post("/v1/deform", json=body), 400, "invalid_request")["field"] == "loads"


def test_materials_can_be_searched(client):
    everything = client.get("/v1/materials").json()["materials"]
    assert len(everything) == len(MATERIALS)
    foams = client.get("/v1/materials", params={"q": "foam soft"}).json()["materials"]
    assert {"foam_soft", "foam_very_soft"} <= {entry["name"] for entry in foams}
    assert all(entry["source"] for entry in foams)
    assert client.get("/v1/materials", params={"q": "unobtainium"}).json() == {"materials": []}
    problem(client.get("/v1/materials", params={"q": "x" * 101}), 400, "invalid_request")


def test_models_are_listed(client):
    assert client.get("/v1/models").json()["models"][0]["name"] == "fake"


def test_unknown_routes_and_methods_are_problem_documents_too(client):
    problem(client.get("/v2/nothing"), 404, "not_found")
    assert "allow" in client.get("/v1/deform").headers
    problem(client.get("/v1/deform"), 405, "method_not_allowed")


@pytest.mark.parametrize("path", ["/", "/docs"])
def test_pages_load_nothing_from_elsewhere(client, path):
    reply = client.get(path)
    assert reply.status_code == 200
    assert reply.headers["content-type"].startswith("text/html")
    # The name of a namespace is no address.
    page = reply.text.replace("http://www.w3.org/2000/svg", "")
    assert "://" not in page, "a robot's network has no way out"
    assets = re.findall(r'(?:src|href)="(/web/[^"]+)"', page)
    assert assets
    for asset in assets:
        assert client.get(asset).status_code == 200


def test_the_playground_may_load_nothing_from_elsewhere_and_is_never_stale(client):
    page = client.get("/")
    assert "default-src 'self'" in page.headers["content-security-policy"]
    assert page.headers["cache-control"] == "no-cache"
    (script,) = re.findall(r'src="(/web/assets/[^"]+)"', page.text)
    assert "immutable" in client.get(script).headers["cache-control"]
    sample = client.get("/web/samples/mug/depth.png")
    assert sample.headers["cache-control"] == "no-cache"
    again = client.get("/web/samples/mug/depth.png", headers={"If-None-Match": sample.headers["etag"]})
    assert again.status_code == 304


def test_every_code_of_a_problem_has_its_page(client):
    document = problem(client.post("/v1/deform", json={}), 400, "invalid_request")
    page = client.get(document["type"]).json()
    assert page["http"] == 400
    assert page["meaning"]
    problem(client.get("/problems/made_up"), 404, "not_found")


def test_metrics_count_requests_stages_and_queue(client):
    before = counter(client, "ok")
    for _ in range(3):
        client.post("/v1/deform", json=SCENE.request())
    text = client.get("/metrics").text
    assert counter(client, "ok") == before + 3
    assert 'physnet_stage_seconds_bucket{le="0.002",stage="deform"}' in text
    assert "physnet_queue_depth 0.0" in text
    assert "physnet_ready 1.0" in text
    assert 'physnet_model_info{kind="deformation",name="fake",version="9.9.9"} 1.0' in text


def test_a_full_queue_is_told_with_retry_after_and_a_vanished_client_frees_its_place():
    gate, entered = threading.Event(), threading.Event()

    def hold(_):
        entered.set()
        assert gate.wait(10)

    with running(FakePredictor(hold), queue_size=1) as service:
        replies: list[int] = []

        def post(timeout: float = 10) -> None:
            try:
                reply = httpx.post(f"{service.url}/v1/deform", json=SCENE.request(), timeout=timeout)
                replies.append(reply.status_code)
            except httpx.TimeoutException:
                replies.append(0)

        first = threading.Thread(target=post)
        first.start()
        assert entered.wait(10)
        impatient = threading.Thread(target=post, args=(2.0,))
        impatient.start()
        assert until(lambda: queue_depth(service.url) == 1)
        refused = httpx.post(f"{service.url}/v1/deform", json=SCENE.request())
        document = problem(refused, 503, "overloaded")
        assert int(refused.headers["retry-after"]) >= 1
        assert "try again" in document["detail"]
        impatient.join()
        assert until(lambda: queue_depth(service.url) == 0), "a client that went away kept its place in the queue"
        patient = threading.Thread(target=post)
        patient.start()
        assert until(lambda: queue_depth(service.url) == 1)
        gate.set()
        first.join()
        patient.join()
    assert sorted(replies) == [0, 200, 200]
    assert len(service.predictor.asked) == 2


def test_a_token_is_asked_for_where_one_is_set():
    with running(FakePredictor(), token="s3cret") as service, httpx.Client(base_url=service.url) as client:
        body = SCENE.request()
        for headers in ({}, {"Authorization": "Bearer wrong"}, {"Authorization": "Basic s3cret"}):
            reply = client.post("/v1/deform", json=body, headers=headers)
            problem(reply, 401, "unauthenticated")
            assert reply.headers["www-authenticate"] == "Bearer"
        problem(client.get("/v1/models"), 401, "unauthenticated")
        assert client.post("/v1/deform", json=body, headers={"Authorization": "Bearer s3cret"}).status_code == 200
        # Probes and pages carry no token.
        for path in ("/healthz", "/readyz", "/metrics", "/docs", "/openapi.json"):
            assert client.get(path).status_code == 200
        assert client.get("/openapi.json").json()["components"]["securitySchemes"]["bearer"]["scheme"] == "bearer"
    assert len(service.predictor.asked) == 1
