"""The client on both wires of a service on real sockets, around a predictor without networks."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from service.api import convert
from service.api.schemas import DeformBody
from service.client import (
    AsyncPhysNetClient,
    Camera,
    ContactOffBody,
    DeadlineExceeded,
    Earlier,
    Image,
    InvalidRequest,
    NotInReply,
    Overloaded,
    PhysNetClient,
    Push,
    Result,
    Retry,
    ServiceUnreachable,
    Shape,
    Unauthenticated,
    UnexpectedReply,
    UnknownMaterial,
)
from service.client.http_wire import displacement_from
from service.core import errors as core_errors
from service.core.messages import EarlierReconstruction, KnownShape, Observation
from tests.service.box_scene import BoxScene
from tests.service.client.ports import free_ports
from tests.service.fakes import FakePredictor, Running, fake_result, running
from tests.service.waiting import metric, queue_depth, until

SCENE = BoxScene(width=64, height=48, focal_px=60.0)
CAMERA = Camera.from_json(SCENE.camera)
PUSH = Push(contact_m=SCENE.in_camera(SCENE.front_m()), force_n=SCENE.direction((0.0, 4.0, 0.0)))
SOFT = (1e5, 0.45)
ONCE = Retry(attempts=1)


def react(request: Any) -> None:
    if request.material.young_modulus_pa == 404.0:
        raise ContactOffBody("Too far.", field="loads[0].contact_m", expected=0.02, actual=0.5)
    if request.material.young_modulus_pa == 666.0:
        raise RuntimeError("a bug")


@pytest.fixture(scope="module")
def service() -> Iterator[Running]:
    with running(FakePredictor(react), max_loads=4) as service:
        yield service


class Blocking:
    """An asynchronous client, called as the blocking one is: so that one test holds both to the same."""

    def __init__(self, url: str, **options: Any) -> None:
        self._loop = asyncio.new_event_loop()
        self._client = self._loop.run_until_complete(self._make(url, **options))

    async def _make(self, url: str, **options: Any) -> AsyncPhysNetClient:
        return AsyncPhysNetClient(url, **options)

    def __getattr__(self, name: str) -> Any:
        method = getattr(self._client, name)
        return lambda *arguments, **named: self._loop.run_until_complete(method(*arguments, **named))

    def __enter__(self) -> Blocking:
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.run_until_complete(self._client.close())
        self._loop.close()


KINDS = {"http": PhysNetClient, "grpc": PhysNetClient, "http async": Blocking, "grpc async": Blocking}


def url(service: Running, kind: str) -> str:
    return f"grpc://{service.grpc}" if kind.startswith("grpc") else service.url


@pytest.fixture(params=KINDS)
def client(request: pytest.FixtureRequest, service: Running) -> Iterator[Any]:
    with KINDS[request.param](url(service, request.param), timeout_s=10.0) as client:
        yield client


def check(result: Result, asked: Any) -> None:
    """The reply is the predictor's, bit for bit as far as the wire carries it."""
    want = fake_result(asked)
    assert result.model == ("fake", "9.9.9")
    assert result.grid.pitch_m == want.grid.pitch_m
    np.testing.assert_array_equal(result.grid.camera_from_grid, want.grid.camera_from_grid)
    np.testing.assert_array_equal(result.reconstruction, want.reconstruction)
    assert result.flags == want.flags
    assert result.timing_ms["deform"] == 2.0
    assert len(result) == len(want.loads)
    for got, load in zip(result, want.loads, strict=True):
        np.testing.assert_array_equal(got.deformed, load.deformed)
        np.testing.assert_array_equal(got.displacement_m, load.displacement_m.astype(np.float16))
        assert (got.max_displacement_m, got.load_number) == (load.max_displacement_m, load.load_number)
        assert got.flags == {"contact_snapped"}


def test_a_depth_array_is_answered(client, service):
    result = client.deform(SCENE.counts(), CAMERA, PUSH, SOFT)
    asked = service.predictor.asked[-1]
    check(result, asked)
    np.testing.assert_array_equal(result.observed, fake_result(asked).observed)
    assert isinstance(asked.source, Observation)
    assert (asked.source.depth.encoding, asked.source.depth.data) == ("16UC1", SCENE.counts().tobytes())
    assert (asked.material.young_modulus_pa, asked.material.poisson_ratio) == SOFT
    np.testing.assert_allclose(asked.loads[0].contact_m, PUSH.contact_m)
    np.testing.assert_allclose(asked.loads[0].force_n, PUSH.force_n)


def test_displacements_travel_at_the_voxels_of_the_body_alone(client, service):
    """A thirtieth of the bytes; both forms of the field are there."""
    result = client.deform(SCENE.counts(), CAMERA, [PUSH, PUSH], SOFT, outputs=("deformed", "displacement"))
    assert service.predictor.asked[-1].outputs == {"deformed", "displacement_at_voxels"}
    for got, load in zip(result, fake_result(service.predictor.asked[-1]).loads, strict=True):
        np.testing.assert_array_equal(got.moved_m, load.moved_m.astype(np.float16))
        np.testing.assert_array_equal(got.displacement_m, load.displacement_m.astype(np.float16))
        assert got.moved_m.shape[1] == len(got.points_camera())
    # Where the body does not go along, nothing else says where its voxels are.
    result = client.deform(SCENE.counts(), CAMERA, PUSH, SOFT, outputs=("displacement",))
    assert service.predictor.asked[-1].outputs == {"displacement"}
    want_m = fake_result(service.predictor.asked[-1]).loads[0].displacement_m
    np.testing.assert_array_equal(result.displacement_m, want_m.astype(np.float16))
    with pytest.raises(NotInReply, match="'deformed'"):
        _ = result[0].moved_m


@pytest.mark.parametrize("kind", KINDS)
def test_a_service_that_knows_displacements_on_grids_alone_is_understood(kind, monkeypatch):
    """Over HTTP the field of the request is unknown to it and refused, once; over gRPC it is passed over."""
    original = convert.deform_request
    refused = []

    def of_before(body: DeformBody, *rest: Any) -> Any:
        if kind.startswith("http") and "displacement_form" in body.model_fields_set:
            refused.append(body)
            raise core_errors.InvalidRequest("`displacement_form` is not a field.", field="displacement_form")
        return original(body.model_copy(update={"displacement_form": "grid"}), *rest)

    monkeypatch.setattr(convert, "deform_request", of_before)
    with running(FakePredictor()) as service, KINDS[kind](url(service, kind)) as client:
        for _ in range(2):
            check(client.deform(SCENE.counts(), CAMERA, PUSH, SOFT), service.predictor.asked[-1])
            assert "displacement" in service.predictor.asked[-1].outputs
    assert len(refused) == (1 if kind.startswith("http") else 0)


def test_displacements_that_are_not_of_the_body_are_no_reply_of_ours():
    one = np.zeros((64, 64, 64), bool)
    one[3, 4, 5] = True
    np.testing.assert_array_equal(displacement_from(bytes(6), one).grid_m[:, one], np.zeros((3, 1)))
    for data, deformed in ((bytes(12), one), (bytes(8), one), (bytes(6), None)):
        with pytest.raises(UnexpectedReply):
            displacement_from(data, deformed)


def test_everything_that_can_be_asked_arrives(client, service):
    depth_m, mask = SCENE.render()
    camera = Camera.from_json(SCENE.camera | {"distortion": [0.01, 0.0, 0.0, 0.0, 0.0]})
    pushes = [Push((0, 0, 1), contact_px=(30, 20)), Push((1, 0, 0), contact_px=(31.5, 20), patch_radius_m=0.01)]
    result = client.deform(
        depth_m, camera, pushes, "silicone", mask=mask, up=np.array(SCENE.up), roi=(1, 2, 40, 30), unit_m=0.5,
        outputs=("reconstruction", "probability"), threshold=0.4, uncertainty_samples=3,
    )  # fmt: skip
    asked = service.predictor.asked[-1]
    source = asked.source
    assert (source.depth.encoding, source.depth.unit_m) == ("32FC1", 0.5)
    assert source.depth.data == depth_m.astype("<f4").tobytes()
    from service.core.depth import decode_mask

    np.testing.assert_array_equal(decode_mask("png8", source.mask.data, 64, 48), mask)
    np.testing.assert_allclose(source.up, np.array(SCENE.up) / np.linalg.norm(SCENE.up))
    assert (source.roi, source.intrinsics.distortion[0]) == ((1, 2, 40, 30), 0.01)
    assert (asked.material.name, asked.threshold, asked.uncertainty_samples) == ("silicone", 0.4, 3)
    assert [load.contact_px for load in asked.loads] == [(30.0, 20.0), (31.5, 20.0)]
    assert asked.loads[1].patch_radius_m == 0.01
    assert asked.outputs == {"reconstruction", "probability"}
    want = fake_result(asked)
    np.testing.assert_allclose(result[1].probability, want.loads[1].probability, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(result.body_probability, want.reconstruction_probability, atol=0.5 / 255 + 1e-6)
    with pytest.raises(NotInReply, match="'deformed'"):
        _ = result.deformed


def test_a_known_shape_is_answered(client, service):
    body = np.zeros((64, 64, 64), bool)
    body[20:44, 22:40, :30] = True
    pose = np.eye(4)
    pose[:3, 3] = (-0.1, -0.1, 0.4)
    result = client.deform(Shape(body, 0.003, pose), push=Push((0, 0, 2), contact_m=(0, 0, 0.5)), material=SOFT)
    asked = service.predictor.asked[-1]
    assert isinstance(asked.source, KnownShape)
    assert asked.source.data == np.packbits(body.ravel(), bitorder="little").tobytes()
    np.testing.assert_array_equal(asked.source.camera_from_grid, pose)
    check(result, asked)
    with pytest.raises(NotInReply):
        _ = result.observed


@pytest.mark.parametrize("encoding", ["png16", "npy", "compressedDepth", "32FC1; compressedDepth rvl"])
def test_bytes_go_as_they_came(client, service, encoding):
    client.deform(Image(encoding, b"\x00\x01" * 20, 0.002), CAMERA, PUSH, SOFT)
    depth = service.predictor.asked[-1].source.depth
    # The fake predictor decodes nothing, so what arrived is what was sent.
    assert (depth.encoding, depth.data, depth.unit_m) == (encoding, b"\x00\x01" * 20, 0.002)


def test_a_body_is_asked_about_again_by_its_id(client, service):
    """Without the frame: what was reconstructed once need not be again."""
    client.deform(Earlier("abc"), push=PUSH, material=SOFT)
    asked = service.predictor.asked[-1]
    assert asked.source == EarlierReconstruction("abc")
    with pytest.raises(NotInReply, match="send the frame again"):
        _ = client.deform(SCENE.counts(), CAMERA, PUSH, SOFT).earlier


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


def test_materials_and_models(client):
    found = client.materials("soft foam")
    assert {"foam_soft"} <= {entry.name for entry in found}
    entry = found[0]
    assert entry.young_modulus_range_pa[0] <= entry.young_modulus_pa <= entry.young_modulus_range_pa[1]
    assert client.models()[0]["name"] == "fake"


@pytest.mark.parametrize("kind", KINDS)
def test_a_full_queue_is_tried_again_when_it_says_so(kind):
    """The first is with the worker, the second fills the queue; the third is refused, waits, and is answered."""
    gate = threading.Semaphore(0)
    entered = threading.Semaphore(0)

    def hold(_: Any) -> None:
        entered.release()
        assert gate.acquire(timeout=20)

    with running(FakePredictor(hold), queue_size=1) as service:
        answers: list[Result] = []

        def ask() -> None:
            with PhysNetClient(service.url, retry=ONCE) as other:
                answers.append(other.deform(SCENE.counts(), CAMERA, PUSH, SOFT))

        def release_once_refused(before: float) -> None:
            assert until(lambda: metric(service.url, 'physnet_rejected_total{reason="overloaded"') > before)
            gate.release(5)

        threads = [threading.Thread(target=ask) for _ in range(2)]
        threads[0].start()
        assert entered.acquire(timeout=10)
        threads[1].start()
        assert until(lambda: queue_depth(service.url) == 1)
        with KINDS[kind](url(service, kind), retry=ONCE) as client:
            began = time.monotonic()
            with pytest.raises(Overloaded) as caught:
                client.deform(SCENE.counts(), CAMERA, PUSH, SOFT)
            assert caught.value.retry_after_s > 0.0
            assert time.monotonic() - began < 5.0
        with KINDS[kind](url(service, kind), timeout_s=20.0) as client:
            told = metric(service.url, 'physnet_rejected_total{reason="overloaded"')
            threading.Thread(target=release_once_refused, args=(told,)).start()
            began = time.monotonic()
            check(client.deform(SCENE.counts(), CAMERA, PUSH, SOFT), service.predictor.asked[0])
            # It came back after the time that it was told, not at once.
            assert time.monotonic() - began >= caught.value.retry_after_s * 0.99
        for thread in threads:
            thread.join(timeout=10)
    assert len(answers) == 2


@pytest.mark.parametrize("kind", KINDS)
def test_a_deadline_ends_the_call_and_the_service_hears_of_it(kind):
    gate = threading.Event()
    gate.set()

    def hold(_: Any) -> None:
        gate.wait(20)

    with running(FakePredictor(hold)) as service, KINDS[kind](url(service, kind)) as client:
        # The connection is there, so that the deadline is that of a question and its answer.
        client.deform(SCENE.counts(), CAMERA, PUSH, SOFT)
        gate.clear()
        began = time.monotonic()
        with pytest.raises(DeadlineExceeded):
            client.deform(SCENE.counts(), CAMERA, PUSH, SOFT, timeout_s=0.4)
        assert 0.3 < time.monotonic() - began < 5.0
        # One that waits behind it has gone from the queue before it was computed.
        with pytest.raises(DeadlineExceeded):
            client.deform(SCENE.counts(), CAMERA, PUSH, SOFT, timeout_s=0.4)
        assert until(lambda: queue_depth(service.url) == 0)
        gate.set()
    assert len(service.predictor.asked) == 2


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


@pytest.mark.parametrize("kind", ["http", "grpc async"])
def test_a_service_that_is_being_started_is_waited_for(kind):
    built = threading.Event()
    ready = {}
    ports = free_ports()

    def serve() -> None:
        with running(FakePredictor(), build=lambda: built.wait(10), http_port=ports[0], grpc_port=ports[1]) as service:
            ready["service"] = service
            stop.wait(20)

    stop = threading.Event()
    thread = threading.Thread(target=serve)
    thread.start()
    try:
        wire, port = ("grpc", ports[1]) if kind.startswith("grpc") else ("http", ports[0])
        with KINDS[kind](f"{wire}://127.0.0.1:{port}") as client:
            # The one error after a pause that would have lasted beyond the deadline, the other without.
            with pytest.raises((DeadlineExceeded, Overloaded, ServiceUnreachable)):
                client.wait_until_ready(timeout_s=0.5)
            built.set()
            client.wait_until_ready(timeout_s=20.0)
            check(client.deform(SCENE.counts(), CAMERA, PUSH, SOFT), ready["service"].predictor.asked[-1])
    finally:
        built.set()
        stop.set()
        thread.join(timeout=20)


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
