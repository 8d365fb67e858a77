"""More than there is time for, and clients that misbehave: the service stays fresh, and fair to everybody else."""

from __future__ import annotations

import json
import math
import os
import queue
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from statistics import median
from typing import Any

import grpc
import httpx
import pytest

from service.api.generated import deformation_pb2 as pb
from service.inference.registry import Models
from service.pipeline import Body, Pipeline
from service.reconstructions import Reconstructions
from tests.conftest import ROOT
from tests.service import rpc_client
from tests.service.box_scene import BoxScene
from tests.service.fakes import FakePredictor, running
from tests.service.waiting import metric, queue_depth, until

SCENE = BoxScene(width=64, height=48, focal_px=60.0)
QUESTION = rpc_client.message(SCENE.request())
INFERENCE_S = 0.05
POST = "POST /v1/deform HTTP/1.1\r\nHost: x\r\nContent-Type: application/json\r\n"
TRUNCATED = pb.DeformStreamRequest(frame_id=2, request=QUESTION).SerializeToString()[:-50]


PROGRAM = f"""
import asyncio, time
import service.app as app
from service.settings import Settings
from tests.service.fakes import FakePredictor, fake_manifest

served = app.Served(FakePredictor(lambda _: time.sleep({INFERENCE_S})), [fake_manifest()])
settings = Settings(http_port=0, grpc_port=0, request_deadline_s=3.0)
announce = lambda line: print(line, flush=True)
raise SystemExit(asyncio.run(app.serve(settings, lambda _: served, announce=announce)))
"""


@dataclass(frozen=True)
class Alone:
    """A service in a process of its own, so that its times and memory are not those of its clients too."""

    url: str
    grpc: str


@pytest.fixture(scope="module")
def alone(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Alone]:
    log = tmp_path_factory.mktemp("overload") / "service.log"
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PHYSNET_")}
    with log.open("w") as errors:
        process = subprocess.Popen(
            [sys.executable, "-c", PROGRAM], cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=errors, text=True
        )
    assert process.stdout is not None
    try:
        line = process.stdout.readline()
        assert line.startswith("ready "), log.read_text("utf-8")
        http, grpc_address = (line.split(f"{wire}=")[1].split()[0] for wire in ("http", "grpc"))
        yield Alone(f"http://{http}", grpc_address)
        assert process.poll() is None, log.read_text("utf-8")
        process.terminate()
        assert process.wait(20) == 0
        assert "Traceback" not in log.read_text("utf-8")
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


class Stream:
    """A robot's stream: frames as they are sent, and each response with the time it came."""

    def __init__(self, channel: grpc.Channel) -> None:
        self._frames: queue.Queue[pb.DeformStreamRequest | None] = queue.Queue()
        self.responses: list[tuple[float, pb.DeformStreamResponse]] = []
        self.sent: dict[int, float] = {}
        self.status: grpc.StatusCode | None = None
        self.call = rpc_client.stub(channel).DeformStream(iter(self._frames.get, None), timeout=60)
        self._reading = threading.Thread(target=self._read)
        self._reading.start()

    def _read(self) -> None:
        try:
            for response in self.call:
                self.responses.append((time.monotonic(), response))
        except grpc.RpcError as error:
            self.status = error.code()

    def send(self, number: int, **changes: Any) -> None:
        self.sent[number] = time.monotonic()
        self._frames.put(pb.DeformStreamRequest(frame_id=number, request=QUESTION, **changes))

    def at_rate(self, rate_hz: float, count: int) -> None:
        """On schedule, whatever comes back."""
        began = time.monotonic()
        for number in range(1, count + 1):
            time.sleep(max(0.0, began + number / rate_hz - time.monotonic()))
            self.send(number)

    def hang_up(self) -> None:
        self._frames.put(None)
        self._reading.join(timeout=20)
        assert not self._reading.is_alive(), "the stream did not end"

    def answered(self) -> dict[int, float]:
        """Age of each answer when it had come back, from when its frame was sent, seconds."""
        return {
            response.frame_id: came - self.sent[response.frame_id]
            for came, response in self.responses
            if response.WhichOneof("outcome") == "answer"
        }

    def ages_ms(self) -> list[float]:
        """Age of each answer when it was handed to the network, as the service measures it."""
        return [response.age_ms["reply"] for _, response in self.responses if response.HasField("answer")]


def test_a_stream_of_far_too_many_frames_stays_fresh_and_flat(alone):
    """Six times as many frames as can be answered: every one has its response, and what is answered is new.

    Ages are the service's own, from a frame's arrival to its response: a busy machine's clients are late themselves.
    """
    with grpc.insecure_channel(alone.grpc) as channel:
        calm = Stream(channel)
        calm.at_rate(8.0, 8)
        calm.hang_up()
        unloaded_ms = max(calm.ages_ms())
        flooded = Stream(channel)
        flooded.at_rate(120.0, 240)
        before = metric(alone.url, "process_resident_memory_bytes")
        flooded.hang_up()
        again = Stream(channel)
        again.at_rate(120.0, 240)
        again.hang_up()
        after = metric(alone.url, "process_resident_memory_bytes")
    for stream in (flooded, again):
        assert sorted(response.frame_id for _, response in stream.responses) == list(range(1, 241))
        ages_ms = sorted(stream.ages_ms())
        assert 10 < len(ages_ms) < 180
        # One frame is being answered when it comes and it waits in front: no more than that turn and its own.
        assert ages_ms[math.floor(0.9 * len(ages_ms))] <= 3 * unloaded_ms, (ages_ms, unloaded_ms)
        assert max(stream.answered()) == 240, "the newest frame of all is answered"
    assert after - before < 20e6


def test_four_streams_have_their_fair_share(alone):
    channels = [grpc.insecure_channel(alone.grpc, [("physnet.test", number)]) for number in range(4)]
    streams = [Stream(channel) for channel in channels]
    senders = [threading.Thread(target=stream.at_rate, args=(30.0, 60)) for stream in streams]
    for sender in senders:
        sender.start()
    for sender, stream in zip(senders, streams, strict=True):
        sender.join()
        stream.hang_up()
    for channel in channels:
        channel.close()
    shares = [len(stream.answered()) for stream in streams]
    assert min(shares) >= 0.7 * sum(shares) / 4, shares
    # None waits for longer than the turns of the others, that of the frame before, and its own.
    came = sorted(came for stream in streams for came, response in stream.responses if response.HasField("answer"))
    turn_ms = 1e3 * (came[-1] - came[0]) / (len(came) - 1)
    for stream in streams:
        ages_ms = sorted(stream.ages_ms())
        # Six turns, and ten of whatever else this machine does, which lengthens each of them.
        assert ages_ms[math.floor(0.9 * len(ages_ms))] < 16 * turn_ms, (ages_ms, turn_ms)


def deaf_http(service: Alone, others_go_on: Callable[[], None]) -> None:
    """Asks for megabytes and never reads them."""
    body = json.dumps(SCENE.request(outputs=["displacement", "probability"], loads=SCENE.request()["loads"] * 4))
    head = f"{POST}Content-Length: {len(body)}\r\n\r\n"
    sockets = [_connect(service) for _ in range(4)]
    for one in sockets:
        one.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        one.sendall(head.encode() + body.encode())
    others_go_on()
    for one in sockets:
        one.close()


def dripping_http(service: Alone, others_go_on: Callable[[], None]) -> None:
    """Sends a byte now and then."""
    with _connect(service) as one, suppress(OSError):
        one.sendall(f"{POST}Content-Length: 1000000\r\n\r\n".encode())
        for _ in range(20):
            one.sendall(b" ")
            time.sleep(0.02)
        others_go_on()


def vanishing_http(service: Alone, others_go_on: Callable[[], None]) -> None:
    """Goes away in the middle of a frame, again and again."""
    for _ in range(20):
        with _connect(service) as one:
            one.sendall(f"{POST}Content-Length: 1000000\r\n\r\n".encode() + bytes(10_000))


def noise(service: Alone, others_go_on: Callable[[], None]) -> None:
    """Speaks neither HTTP nor HTTP/2, on either port."""
    for url in (service.url.removeprefix("http://"), service.grpc):
        host, port = url.rsplit(":", 1)
        for _ in range(10):
            with socket.create_connection((host, int(port))) as one, suppress(OSError):
                one.sendall(bytes(range(256)) * 40)


def bad_frames(service: Alone, others_go_on: Callable[[], None]) -> None:
    """Frames with one id, past their deadline, without a request, with a thousand loads."""
    with grpc.insecure_channel(service.grpc) as channel:
        stream = Stream(channel)
        many = rpc_client.message(SCENE.request(loads=SCENE.request()["loads"] * 1000))
        for number in range(1, 30):
            stream.send(7)
            stream.send(100 * number, deadline_ms=1e-9)
            stream._frames.put(pb.DeformStreamRequest(frame_id=100 * number + 1))
            stream._frames.put(pb.DeformStreamRequest(frame_id=100 * number + 2, request=many))
        stream.hang_up()
        outcomes = [response.WhichOneof("outcome") for _, response in stream.responses]
        assert len(outcomes) == 29 * 4
        assert outcomes.count("problem") >= 29 * 4 - 1


def cut_streams(service: Alone, others_go_on: Callable[[], None]) -> None:
    """Streams whose connection is cut in the middle of a large frame, as when a robot leaves its radio's reach."""
    large = pb.DeformStreamRequest(frame_id=1, request=QUESTION)
    large.request.depth.data = bytes(4_000_000)
    for _ in range(4):
        with _relay(service.grpc, cut_after=200_000) as address:
            # What a client tries again by itself is no matter here.
            with grpc.insecure_channel(address, [("grpc.enable_retries", 0)]) as channel:
                call = rpc_client.stub(channel).DeformStream(iter([large]), timeout=30)
                with pytest.raises(grpc.RpcError) as lost:
                    next(iter(call))
                assert lost.value.code() == grpc.StatusCode.UNAVAILABLE


def deaf_streams(service: Alone, others_go_on: Callable[[], None]) -> None:
    """Streams that never read their responses, and then are given up."""
    with grpc.insecure_channel(service.grpc) as channel:
        question = rpc_client.message(SCENE.request(outputs=["displacement"]))
        frames = [pb.DeformStreamRequest(frame_id=number, request=question) for number in range(100)]
        calls = [rpc_client.stub(channel).DeformStream(iter(frames), timeout=10) for _ in range(2)]
        others_go_on()
        for call in calls:
            call.cancel()


@pytest.mark.parametrize(
    "misbehave",
    [deaf_http, dripping_http, vanishing_http, noise, bad_frames, cut_streams, deaf_streams],
    ids=lambda function: function.__name__,
)
def test_whoever_misbehaves_every_other_stream_keeps_its_time(alone, misbehave):
    with grpc.insecure_channel(alone.grpc) as channel:
        stream = Stream(channel)
        stop = threading.Event()

        def frames() -> None:
            for number in range(1, 600):
                if stop.wait(0.1):
                    return
                stream.send(number)

        def others_go_on() -> None:
            seen = len(stream.responses)
            assert until(lambda: len(stream.responses) >= seen + 5), "the good stream has stalled"

        robot = threading.Thread(target=frames)
        robot.start()
        try:
            others_go_on()
            assert until(lambda: len(stream.ages_ms()) >= 5)
            calm_ms = stream.ages_ms()
            misbehave(alone, others_go_on)
            others_go_on()
        finally:
            stop.set()
            robot.join()
            stream.hang_up()
    assert len(stream.responses) == len(stream.sent)
    ages_ms = sorted(stream.ages_ms())
    # What is meant is that nothing blocks the loop or the worker; how long a frame takes on this machine, and what else
    # that has to do, is what it took just before.
    assert ages_ms[math.floor(0.9 * len(ages_ms))] < 20 * median(calm_ms), (ages_ms, calm_ms)
    assert httpx.get(f"{alone.url}/readyz").status_code == 200
    assert until(lambda: queue_depth(alone.url) == 0)


@pytest.mark.parametrize(
    ("data", "code"),
    [
        (b"\xff\xff\xff", grpc.StatusCode.INVALID_ARGUMENT),
        (TRUNCATED, grpc.StatusCode.INVALID_ARGUMENT),
        (bytes(200_000), grpc.StatusCode.RESOURCE_EXHAUSTED),
    ],
    ids=["garbage", "truncated", "oversized"],
)
def test_a_message_that_is_none_ends_its_stream_alone_with_a_named_error(data, code):
    with running(FakePredictor(), max_body_bytes=100_000) as service, grpc.insecure_channel(service.grpc) as channel:
        good = Stream(channel)
        raw = channel.stream_stream("/physnet.v1.DeformationService/DeformStream")
        with pytest.raises(grpc.RpcError) as ended:
            list(raw(iter([data]), timeout=10))
        assert ended.value.code() == code
        if code == grpc.StatusCode.INVALID_ARGUMENT:
            assert rpc_client.problem(ended.value)["code"] == "invalid_request"
        good.send(1)
        assert until(lambda: len(good.responses) == 1)
        good.hang_up()
        assert list(good.answered()) == [1]


def test_after_a_restart_channels_find_the_service_again_and_ids_are_gone(models: Models):
    """The same channel and the same client, before and after; what was kept is asked for in vain, by its name."""

    def fresh() -> Any:
        return Pipeline(models.reconstruction, models.deformation, kept=Reconstructions[Body](2**24, 60.0))

    scene = BoxScene(width=160, height=120, focal_px=150.0)
    body = scene.request(outputs=[])
    with running(fresh()) as service, httpx.Client(base_url=service.url) as client:
        channel = grpc.insecure_channel(service.grpc)
        stub = rpc_client.stub(channel)
        first = stub.Deform(rpc_client.message(body), timeout=30)
        again = {name: body[name] for name in ("material", "loads", "outputs")}
        again["reconstruction_id"] = first.reconstruction_id
        assert stub.Deform(rpc_client.message(again), timeout=30).loads == first.loads
        ports = [int(url.rsplit(":", 1)[1]) for url in (service.url, service.grpc)]
        assert service.stop() == 0
        with pytest.raises((httpx.ConnectError, httpx.RemoteProtocolError, httpx.ReadError)):
            client.post("/v1/deform", json=body)
        with running(fresh(), http_port=ports[0], grpc_port=ports[1]):
            with pytest.raises(grpc.RpcError) as gone:
                stub.Deform(rpc_client.message(again), timeout=30, wait_for_ready=True)
            assert gone.value.code() == grpc.StatusCode.NOT_FOUND
            assert rpc_client.problem(gone.value)["code"] == "reconstruction_gone"
            refused = client.post("/v1/deform", json=again)
            assert (refused.status_code, refused.json()["code"]) == (410, "reconstruction_gone")
            assert stub.Deform(rpc_client.message(body), timeout=30).loads == first.loads
        channel.close()


def _connect(service: Alone) -> socket.socket:
    host, port = service.url.removeprefix("http://").rsplit(":", 1)
    return socket.create_connection((host, int(port)), timeout=10)


@contextmanager
def _relay(target: str, cut_after: int) -> Iterator[str]:
    """An address that passes everything on to `target`, until so many bytes have come from the client."""
    host, port = target.rsplit(":", 1)
    listener = socket.create_server(("127.0.0.1", 0))

    def pump(source: socket.socket, sink: socket.socket, budget: float) -> None:
        with suppress(OSError):
            while budget > 0 and (data := source.recv(65536)):
                sink.sendall(data)
                budget -= len(data)
        for one in (source, sink):
            with suppress(OSError):
                # A reset, not a farewell.
                one.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\x01\x00\x00\x00\x00\x00\x00\x00")
                one.shutdown(socket.SHUT_RDWR)
                one.close()

    def accept() -> None:
        with suppress(OSError):
            while True:
                client, _ = listener.accept()
                server = socket.create_connection((host, int(port)))
                for arguments in ((client, server, float(cut_after)), (server, client, math.inf)):
                    threading.Thread(target=pump, args=arguments, daemon=True).start()

    threading.Thread(target=accept, daemon=True).start()
    try:
        yield f"127.0.0.1:{listener.getsockname()[1]}"
    finally:
        listener.close()
