"""Streams on both wires and for both kinds of client: the newest frame wins, every frame is accounted for."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
import pytest

from service.client import Answer, AsyncPhysNetClient, Camera, PhysNetClient, Push, ServiceUnreachable, question
from service.client.frames import FrameBook
from service.core.errors import ContactOffBody, PhysNetError, Unauthenticated
from tests.service.box_scene import BoxScene
from tests.service.client.ports import free_ports
from tests.service.fakes import FakePredictor, Running, running
from tests.service.waiting import until

SCENE = BoxScene(width=64, height=48, focal_px=60.0)
CAMERA = Camera.from_json(SCENE.camera)
DEPTH = SCENE.counts()
PUSH = Push(contact_m=SCENE.in_camera(SCENE.front_m()), force_n=SCENE.direction((0.0, 4.0, 0.0)))
ARGUMENTS = (DEPTH, CAMERA, PUSH)
WIRES = ("http", "grpc")


def url(service: Running, wire: str) -> str:
    return f"grpc://{service.grpc}" if wire == "grpc" else service.url


class Gate:
    """Holds the worker until a pass is given, and says whose turn it was."""

    def __init__(self) -> None:
        self.passes = threading.Semaphore(0)
        self.entered = threading.Semaphore(0)

    def __call__(self, request: Any) -> None:
        self.entered.release()
        assert self.passes.acquire(timeout=30)
        if request.material.young_modulus_pa == 404.0:
            raise ContactOffBody("Too far.", field="loads[0].contact_m", actual=0.5)


@pytest.fixture
def gate() -> Gate:
    return Gate()


@pytest.fixture
def service(gate: Gate) -> Iterator[Running]:
    with running(FakePredictor(gate)) as service:
        yield service
        gate.passes.release(1000)


def outcome(answer: Answer | None) -> tuple[int, str]:
    assert answer is not None
    kinds = {"answer": answer.result, "problem": answer.error, "skipped": answer.overtaken_by}
    (kind,) = [name for name, value in kinds.items() if value is not None]
    return answer.frame_id, kind


@pytest.mark.parametrize("wire", WIRES)
def test_the_newest_frame_wins_and_every_frame_is_accounted_for(service, gate, wire):
    with PhysNetClient(url(service, wire)) as client, client.stream(with_skipped=True) as stream:
        stream.send(*ARGUMENTS, frame_id=7)
        assert gate.entered.acquire(timeout=20)
        for number in range(8, 14):
            stream.send(*ARGUMENTS, frame_id=number)
        # Those that never travelled are told of before one that the service tells of, which a later one overtook there.
        skipped = sorted((stream.next(timeout_s=20.0) for _ in range(5)), key=lambda answer: answer.frame_id)
        assert [outcome(answer) for answer in skipped] == [(number, "skipped") for number in range(8, 13)]
        assert all(answer.frame_id < answer.overtaken_by <= 13 for answer in skipped)
        gate.passes.release(2)
        first, last = stream.next(timeout_s=20.0), stream.next(timeout_s=20.0)
        assert (outcome(first), outcome(last)) == ((7, "answer"), (13, "answer"))
        assert first.unwrap().max_displacement_m == 0.003
        assert min(first.round_trip_ms, last.round_trip_ms) > 0.0
        assert bool(first.age_ms) == (wire == "grpc")
        with pytest.raises(ValueError, match=f"frame 8 was overtaken by frame {skipped[0].overtaken_by}"):
            skipped[0].unwrap()
        with pytest.raises(ValueError, match="upwards"):
            stream.send(*ARGUMENTS, frame_id=13)
        counts = stream.counts()
    assert (counts.sent, counts.answered, counts.skipped, counts.failed) == (7, 2, 5, 0)
    assert len(service.predictor.asked) == 2


def test_a_frame_that_waits_is_overtaken_by_the_next_and_told_of_at_once():
    """On this side of the wire alone: what waits, what is under way, and what the service says of it later."""
    book = FrameBook(max_in_flight=2, backlog=64, with_skipped=True)
    asked = question(DEPTH, CAMERA, PUSH)
    for number in (7, 9):
        book.add(asked, number)
        assert book.next().frame_id == number
    for number in range(10, 14):
        book.add(asked, number)
        assert book.next() is None, "two are under way"
    # 9 has been overtaken in the service by then, of which its word comes later.
    assert [(told.frame_id, told.overtaken_by) for told in book.answers] == [(10, 11), (11, 12), (12, 13)]
    book.done(Answer(9, overtaken_by=13))
    assert book.next().frame_id == 13 and book.next() is None
    book.done(Answer(9, overtaken_by=13))
    assert [(told.frame_id, told.overtaken_by) for told in book.answers][3:] == [(9, 13)], "told once"
    counts = book.counts
    assert (counts.sent, counts.answered, counts.skipped, counts.failed) == (6, 0, 4, 0)
    assert not book.idle and not book.waits


@pytest.mark.parametrize("wire", WIRES)
def test_a_problem_is_that_frames_alone_and_leaving_waits_for_what_is_due(service, gate, wire):
    gate.passes.release(10)
    with PhysNetClient(url(service, wire)) as client:
        with client.stream() as stream:
            stream.send(*ARGUMENTS, (404.0, 0.3))
            answer = stream.next(timeout_s=20.0)
            with pytest.raises(ContactOffBody) as caught:
                answer.unwrap()
            assert caught.value.field == "loads[0].contact_m"
            stream.send(*ARGUMENTS)
        # The stream is closed, its last answer is there, and then it ends.
        assert [outcome(answer) for answer in stream] == [(1, "answer")]
        with pytest.raises(ServiceUnreachable):
            stream.send(*ARGUMENTS)


def test_a_link_that_takes_no_more_keeps_only_the_newest_frame(gate):
    """Two frames are under way at most, here with a worker each; newer ones overtake each other on this side."""
    with (
        running(FakePredictor(gate), workers=2) as service,
        PhysNetClient(url(service, "grpc")) as client,
        client.stream(max_in_flight=2, with_skipped=True) as stream,
    ):
        for _ in range(2):
            stream.send(*ARGUMENTS)
            assert gate.entered.acquire(timeout=20)
        for _ in range(5):
            stream.send(*ARGUMENTS)
        skipped = [stream.next(timeout_s=20.0) for _ in range(4)]
        assert [outcome(answer) for answer in skipped] == [(n, "skipped") for n in (2, 3, 4, 5)]
        assert not any(answer.age_ms for answer in skipped), "they never travelled"
        gate.passes.release(3)
        assert [outcome(stream.next(timeout_s=20.0)) for _ in range(3)] == [(n, "answer") for n in (0, 1, 6)]


def test_who_reads_late_gets_the_newest():
    book = FrameBook(max_in_flight=8, backlog=2, with_skipped=False)
    asked = question(np.zeros((2, 2), np.uint16), CAMERA, PUSH)
    for number in range(4):
        book.add(asked, number)
        frame = book.next()
        assert frame is not None and book.next() is None
        book.done(Answer(number, error=PhysNetError("made up")))
    assert [answer.frame_id for answer in book.answers] == [2, 3]
    assert (book.counts.failed, book.counts.dropped, book.idle) == (4, 2, True)


@pytest.mark.parametrize("wire", WIRES)
def test_the_latest_answer_leaves_older_ones(service, gate, wire):
    gate.passes.release(10)
    with PhysNetClient(url(service, wire)) as client, client.stream() as stream:
        for number in range(3):
            stream.send(*ARGUMENTS)
            assert until(lambda n=number: stream.counts().answered == n + 1)
        assert stream.latest(timeout_s=1.0).frame_id == 2
        assert stream.counts().dropped == 2
        assert stream.next(timeout_s=0.05) is None


def test_a_service_that_is_started_again_is_found_again():
    ports = dict(zip(("http_port", "grpc_port"), free_ports(), strict=True))
    with ExitStack() as stack:
        with running(FakePredictor(), **ports):
            client = stack.enter_context(PhysNetClient(f"grpc://127.0.0.1:{ports['grpc_port']}"))
            stream = stack.enter_context(client.stream())
            stream.send(*ARGUMENTS)
            assert outcome(stream.next(timeout_s=20.0)) == (0, "answer")
        # Frames that are sent while nobody is there fail, or wait to be overtaken; none is lost without a word.
        stream.send(*ARGUMENTS)
        assert isinstance(stream.next(timeout_s=20.0).error, ServiceUnreachable)
        with running(FakePredictor(), **ports):
            for _ in range(200):
                stream.send(*ARGUMENTS)
                answer = stream.latest(timeout_s=0.5)
                if answer is not None and answer.result is not None:
                    break
            else:
                pytest.fail("the service was not found again")
        counts = stream.counts()
    assert counts.answered == 2
    assert counts.answered + counts.failed + counts.skipped <= counts.sent


def test_a_stream_that_nobody_will_ever_answer_says_why():
    with running(FakePredictor(), token="secret") as service, PhysNetClient(url(service, "grpc")) as client:
        stream = client.stream()
        with pytest.raises(Unauthenticated):
            list(stream)
        with pytest.raises(ServiceUnreachable):
            stream.send(*ARGUMENTS)
        stream.close()


@pytest.mark.parametrize("wire", WIRES)
def test_a_stream_that_is_given_up_ends_at_once(service, gate, wire):
    with PhysNetClient(url(service, wire)) as client:
        stream = client.stream()
        stream.send(*ARGUMENTS)
        assert gate.entered.acquire(timeout=20)
        began = time.monotonic()
        stream.close(drain=False, timeout_s=0.1)
        assert time.monotonic() - began < 5.0
        assert [outcome(answer) for answer in stream] == [(0, "problem")]
        gate.passes.release(10)


@pytest.mark.parametrize("wire", WIRES)
def test_the_same_for_asyncio(service, gate, wire):
    async def robot() -> None:
        async with (
            AsyncPhysNetClient(url(service, wire)) as client,
            client.stream(with_skipped=True) as stream,
        ):
            stream.send(*ARGUMENTS, frame_id=7)
            assert await asyncio.to_thread(gate.entered.acquire, timeout=20)
            for number in range(8, 12):
                stream.send(*ARGUMENTS, frame_id=number)
            # None of these has left: the loop has had no turn in between.
            skipped = [await asyncio.wait_for(stream.next(), 20) for _ in range(3)]
            assert [(answer.frame_id, answer.overtaken_by) for answer in skipped] == [(8, 9), (9, 10), (10, 11)]
            gate.passes.release(10)
            answers = [outcome(await asyncio.wait_for(stream.next(), 20)) for _ in range(2)]
            assert answers == [(7, "answer"), (11, "answer")]
            stream.send(*ARGUMENTS, (404.0, 0.3))
            assert outcome(await asyncio.wait_for(stream.next(), 20)) == (12, "problem")
            stream.send(*ARGUMENTS)
        # Left, it has waited for the last one.
        assert [outcome(answer) async for answer in stream] == [(13, "answer")]
        assert stream.counts().skipped == 3
        with pytest.raises(ServiceUnreachable):
            stream.send(*ARGUMENTS)

    asyncio.run(robot())


def test_asyncio_finds_a_service_again_and_hears_why_there_will_be_none():
    ports = dict(zip(("http_port", "grpc_port"), free_ports(), strict=True))
    address = f"grpc://127.0.0.1:{ports['grpc_port']}"

    async def robot() -> None:
        async with AsyncPhysNetClient(address) as client, client.stream() as stream:
            stream.send(*ARGUMENTS)
            assert isinstance((await asyncio.wait_for(stream.next(), 20)).error, ServiceUnreachable)
            with running(FakePredictor(), **ports):
                for _ in range(200):
                    stream.send(*ARGUMENTS)
                    if (await asyncio.wait_for(stream.next(), 20)).result is not None:
                        break
                else:
                    pytest.fail("the service was not found")
        with running(FakePredictor(), token="secret", **ports):
            async with AsyncPhysNetClient(address) as client:
                with pytest.raises(Unauthenticated):
                    await asyncio.wait_for(client.stream().next(), 20)

    asyncio.run(robot())
