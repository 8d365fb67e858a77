"""What goes wrong, as the client says it: of the question, of the service, and where there is none."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from service.client import (
    ContactOffBody,
    InvalidRequest,
    PhysNetClient,
    Push,
    Retry,
    ServiceUnreachable,
    Unauthenticated,
    UnexpectedReply,
    UnknownMaterial,
)
from service.core import errors as core_errors
from tests.service.client.kinds import CAMERA, KINDS, PUSH, SCENE, SOFT, check, url
from tests.service.fakes import FakePredictor, running


def test_a_problem_is_raised_as_its_class_with_code_and_field(client):
    with pytest.raises(ContactOffBody) as caught:
        client.deform(SCENE.counts(), CAMERA, PUSH, (404.0, 0.3))
    error = caught.value
    assert (error.code, error.field) == ("contact_off_body", "loads[0].contact_m")
    assert (error.expected, error.actual, error.message) == (0.02, 0.5, "Too far.")
    assert any("request id" in note for note in error.__notes__)
    with pytest.raises(UnknownMaterial) as caught:
        client.deform(SCENE.counts(), CAMERA, PUSH, "silicon")
    assert "silicone" in caught.value.expected
    with pytest.raises(InvalidRequest) as caught:
        client.deform(SCENE.counts(), CAMERA, [Push((0, 0, 1)), Push((0, 0, 1))], SOFT)
    assert caught.value.field == "loads[0]"


def test_a_failure_of_the_service_is_no_fault_of_the_question(client):
    with pytest.raises(core_errors.PhysNetError) as caught:
        client.deform(SCENE.counts(), CAMERA, PUSH, (666.0, 0.3))
    assert caught.value.code == "internal"
    assert not isinstance(caught.value, InvalidRequest)


@pytest.mark.parametrize("kind", KINDS)
def test_nobody_there(kind):
    wire = "grpc" if kind.startswith("grpc") else "http"
    with KINDS[kind](f"{wire}://127.0.0.1:9", retry=Retry(attempts=3, first_s=0.05), timeout_s=20.0) as client:
        with pytest.raises(ServiceUnreachable) as caught:
            client.deform(SCENE.counts(), CAMERA, PUSH, SOFT)
    assert caught.value.code == "unreachable"


@pytest.mark.parametrize("kind", ["http async", "grpc"])
def test_a_token_is_sent(kind):
    with running(FakePredictor(), token="secret") as service:
        with KINDS[kind](url(service, kind)) as client, pytest.raises(Unauthenticated):
            client.deform(SCENE.counts(), CAMERA, PUSH, SOFT)
        with KINDS[kind](url(service, kind), token="secret") as client:
            check(client.deform(SCENE.counts(), CAMERA, PUSH, SOFT), service.predictor.asked[-1])


def test_what_is_no_service_is_named(tmp_path):
    import http.server

    class Other(http.server.BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            status, content = answers.pop(0)
            self.send_response(status)
            self.send_header("Content-Length", str(len(content)))
            self.send_header("Retry-After", "Sun, 22 Nov 2020 07:42:34 GMT")
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, *_: object) -> None:
            pass

    problem = b'{"code": "newer_than_us", "detail": "What is new.", "field": "loads"}'
    answers = [(404, b"<html>"), (200, b"not json"), (418, problem), (502, b""), (200, b'{"models": []}')]
    with http.server.HTTPServer(("127.0.0.1", 0), Other) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        with PhysNetClient(f"http://127.0.0.1:{server.server_port}") as client:
            for _ in range(2):
                with pytest.raises(UnexpectedReply):
                    client.models()
            with pytest.raises(UnexpectedReply, match="What is new") as caught:
                client.models()
            assert (caught.value.code, caught.value.field) == ("newer_than_us", "loads")
            # A gateway whose service is away is asked again.
            assert client.models() == []
        server.shutdown()
        thread.join(timeout=10)
    assert answers == []


@pytest.mark.parametrize("url", ["127.0.0.1:8000", "ftp://robot", "grpc://robot", "http://"])
def test_an_address_that_is_none_is_refused_at_once(url):
    with pytest.raises(ValueError, match=r"grpc://HOST:PORT|ready line"):
        PhysNetClient(url)


@pytest.mark.parametrize("depth", [np.zeros((4, 4, 3), np.uint8), np.zeros((4, 4), np.int32), np.zeros(16, np.float32)])
def test_an_array_that_is_no_depth_image_is_refused_before_it_travels(depth):
    with PhysNetClient() as client, pytest.raises(ValueError, match="height × width"):
        client.deform(depth, CAMERA, PUSH)
