"""Streams of frames over a real socket: the newest frame wins, every frame has one response, no stream starves."""

from __future__ import annotations

import queue
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import grpc
import httpx

from service.api.generated import deformation_pb2 as pb
from service.api.rpc_stream import UNANSWERED
from tests.service import rpc_client
from tests.service.box_scene import BoxScene
from tests.service.fakes import FakePredictor, Running, running
from tests.service.waiting import PATIENCE_S, queue_depth, until

SCENE = BoxScene(width=64, height=48, focal_px=60.0)
QUESTION = rpc_client.message(SCENE.request())


def frame(number: int, **changes: Any) -> pb.DeformStreamRequest:
    return pb.DeformStreamRequest(frame_id=number, request=changes.pop("request", QUESTION), **changes)


class Robot:
    """One stream: sends when told, and keeps what comes back."""

    def __init__(self, channel: grpc.Channel, read: bool = True) -> None:
        self._frames: queue.Queue[pb.DeformStreamRequest | None] = queue.Queue()
        self.call = rpc_client.stub(channel).DeformStream(iter(self._frames.get, None), timeout=60)
        self.responses: queue.Queue[pb.DeformStreamResponse] = queue.Queue()
        self.error: grpc.RpcError | None = None
        self._reading = threading.Thread(target=self._read)
        if read:
            self._reading.start()

    def _read(self) -> None:
        try:
            for response in self.call:
                self.responses.put(response)
        except grpc.RpcError as error:
            self.error = error

    def send(self, *frames: pb.DeformStreamRequest) -> None:
        for one in frames:
            self._frames.put(one)

    def next(self) -> pb.DeformStreamResponse:
        return self.responses.get(timeout=PATIENCE_S)

    def hang_up(self) -> list[pb.DeformStreamResponse]:
        """Half-close; the responses that still come."""
        self._frames.put(None)
        self._reading.join(timeout=PATIENCE_S)
        assert not self._reading.is_alive(), "the stream did not end"
        return [self.responses.get() for _ in range(self.responses.qsize())]

    def vanish(self) -> None:
        self.call.cancel()
        self._frames.put(None)


class Gate:
    """Holds the worker until a pass is given, and says whose turn it was."""

    def __init__(self) -> None:
        self.passes = threading.Semaphore(0)
        self.entered = threading.Semaphore(0)

    def __call__(self, _: Any) -> None:
        self.entered.release()
        assert self.passes.acquire(timeout=20)


@contextmanager
def served(react: Callable[[Any], None] = lambda _: None, **settings: Any) -> Iterator[tuple[Running, grpc.Channel]]:
    with running(FakePredictor(react), **settings) as service, grpc.insecure_channel(service.grpc) as channel:
        yield service, channel


def outcome(response: pb.DeformStreamResponse) -> tuple[int, str]:
    return response.frame_id, response.WhichOneof("outcome")


def test_one_frame_after_the_other_is_answered_with_its_id_ages_and_timings():
    with served() as (_, channel):
        robot = Robot(channel)
        for number in (3, 4, 2**40):
            robot.send(frame(number))
            response = robot.next()
            assert outcome(response) == (number, "answer")
            assert response.answer.timing_ms["decode"] == 1.0
            assert response.answer.request_id.endswith(f"/{number}")
            assert rpc_client.document(response.answer)["loads"][0]["max_displacement_m"] == 0.003
            ages = [response.age_ms[stage] for stage in ("parse", "queue", "decode", "deform")]
            assert ages == sorted(ages)
            assert response.age_ms["encode"] <= response.age_ms["reply"]
        assert robot.hang_up() == []
        assert robot.error is None


def test_a_frame_that_is_overtaken_is_answered_skipped_at_once():
    gate = Gate()
    with served(gate) as (service, channel):
        robot = Robot(channel)
        robot.send(frame(1))
        assert gate.entered.acquire(timeout=10)
        robot.send(*(frame(number) for number in range(2, 12)))
        # While the first is still being computed, all but the newest of the others are done with.
        for number in range(2, 11):
            response = robot.next()
            assert outcome(response) == (number, "skipped")
            assert response.skipped.overtaken_by_frame_id == number + 1
            assert response.age_ms["reply"] >= response.age_ms["parse"]
        gate.passes.release(2)
        assert outcome(robot.next()) == (1, "answer")
        assert outcome(robot.next()) == (11, "answer")
        robot.hang_up()
        metrics = httpx.get(f"{service.url}/metrics").text
    assert len(service.predictor.asked) == 2
    assert 'code="skipped",route="/physnet.v1.DeformationService/DeformStream#frame",wire="grpc"} 9.0' in metrics


def test_what_is_wrong_with_a_frame_is_its_own_answer_and_the_stream_goes_on():
    with served(max_loads=4) as (_, channel):
        robot = Robot(channel)
        robot.send(frame(5))
        assert outcome(robot.next()) == (5, "answer")
        many = rpc_client.message(SCENE.request(loads=SCENE.request()["loads"] * 1000))
        for bad, code, field in (
            (frame(5), "invalid_request", "frame_id"),
            (frame(4), "invalid_request", "frame_id"),
            (pb.DeformStreamRequest(frame_id=6), "invalid_request", "request"),
            (frame(7, deadline_ms=0.0), "invalid_request", "deadline_ms"),
            (frame(8, deadline_ms=float("nan")), "invalid_request", "deadline_ms"),
            (frame(9, request=pb.DeformRequest()), "invalid_request", "material"),
            (frame(10, request=many), "invalid_request", "loads"),
            (frame(11, deadline_ms=1e-9), "deadline_exceeded", None),
        ):
            robot.send(bad)
            response = robot.next()
            assert outcome(response) == (bad.frame_id, "problem")
            problem = rpc_client.problem_document(response.problem)
            assert (problem["code"], problem.get("field")) == (code, field), problem
            assert problem["request_id"].endswith(f"/{bad.frame_id}")
        robot.send(frame(12))
        assert outcome(robot.next()) == (12, "answer")
        assert robot.hang_up() == []


def test_a_bad_frame_does_not_cost_the_one_that_waits_its_place():
    gate = Gate()
    with served(gate) as (_, channel):
        robot = Robot(channel)
        robot.send(frame(1))
        assert gate.entered.acquire(timeout=10)
        robot.send(frame(2), frame(3, request=pb.DeformRequest()))
        assert outcome(robot.next()) == (3, "problem")
        robot.send(frame(4))
        response = robot.next()
        assert (outcome(response), response.skipped.overtaken_by_frame_id) == ((2, "skipped"), 4)
        gate.passes.release(2)
        assert [outcome(robot.next()), outcome(robot.next())] == [(1, "answer"), (4, "answer")]
        robot.hang_up()


def test_streams_take_turns_and_keep_their_place_however_fast_one_sends():
    gate = Gate()
    with served(gate) as (service, channel):
        greedy, modest = Robot(channel), Robot(channel)
        greedy.send(frame(1))
        assert gate.entered.acquire(timeout=10)
        greedy.send(frame(2))
        assert until(lambda: queue_depth(service.url) == 1)
        modest.send(frame(1))
        assert until(lambda: queue_depth(service.url) == 2)
        greedy.send(*(frame(number) for number in range(3, 20)))
        skipped = [greedy.next() for _ in range(17)]
        assert [one.frame_id for one in skipped] == list(range(2, 19))
        gate.passes.release()
        assert outcome(greedy.next()) == (1, "answer")
        gate.passes.release()
        # The newest of the greedy one stands where its first stood, before the modest one, and then it is the turn
        # of the modest one.
        assert outcome(greedy.next()) == (19, "answer")
        assert modest.responses.empty()
        greedy.send(frame(20))
        gate.passes.release()
        assert outcome(modest.next()) == (1, "answer")
        gate.passes.release()
        assert outcome(greedy.next()) == (20, "answer")
        for robot in (greedy, modest):
            assert robot.hang_up() == []


def test_a_client_that_vanishes_gives_its_place_up():
    gate = Gate()
    with served(gate) as (service, channel):
        robot, other = Robot(channel), Robot(channel)
        robot.send(frame(1))
        assert gate.entered.acquire(timeout=10)
        robot.send(frame(2))
        assert until(lambda: queue_depth(service.url) == 1)
        robot.vanish()
        assert until(lambda: queue_depth(service.url) == 0), "a stream that went away kept its place in the queue"
        gate.passes.release(2)
        other.send(frame(1))
        assert outcome(other.next()) == (1, "answer")
        other.hang_up()
    assert len(service.predictor.asked) == 2


def test_one_that_never_reads_and_one_that_never_sends_cost_the_others_nothing():
    with served() as (service, channel):
        with grpc.insecure_channel(service.grpc) as elsewhere:
            deaf, mute, robot = Robot(elsewhere, read=False), Robot(elsewhere), Robot(channel)
            displacement = rpc_client.message(SCENE.request(outputs=["displacement"]))
            sent = 300
            deaf.send(*(frame(number, request=displacement) for number in range(sent)))
            answered = len(service.predictor.asked)
            time.sleep(0.5)
            for number in range(5):
                robot.send(frame(number))
                assert outcome(robot.next()) == (number, "answer")
            # What the deaf one was answered, at 1.5 MiB each, is bounded, and so is what was read of it.
            assert len(service.predictor.asked) - answered <= UNANSWERED + 10
            deaf.vanish()
            mute.vanish()
            assert robot.hang_up() == []


def test_frames_that_come_while_the_queue_is_full_are_told_and_the_stream_goes_on():
    gate = Gate()
    with served(gate, queue_size=1) as (service, channel):
        first, second, third = Robot(channel), Robot(channel), Robot(channel)
        first.send(frame(1))
        assert gate.entered.acquire(timeout=10)
        second.send(frame(1))
        assert until(lambda: queue_depth(service.url) == 1)
        third.send(frame(1))
        response = third.next()
        assert response.problem.code == "overloaded"
        assert response.problem.retry_after_s > 0.0
        gate.passes.release(3)
        assert outcome(first.next()) == outcome(second.next()) == (1, "answer")
        third.send(frame(2))
        assert outcome(third.next()) == (2, "answer")
        for robot in (first, second, third):
            robot.hang_up()


def test_a_stop_answers_what_was_accepted_and_ends_the_stream():
    gate = Gate()
    with served(gate) as (service, channel):
        robot = Robot(channel)
        robot.send(frame(1))
        assert gate.entered.acquire(timeout=10)
        stopping = threading.Thread(target=service.stop)
        stopping.start()
        assert until(lambda: httpx.get(f"{service.url}/readyz").status_code == 503)
        robot.send(frame(2))
        response = robot.next()
        assert (outcome(response), response.problem.code) == ((2, "problem"), "overloaded")
        gate.passes.release()
        assert outcome(robot.next()) == (1, "answer")
        stopping.join(timeout=10)
        robot.hang_up()
        assert robot.error is not None
        assert robot.error.code() in (grpc.StatusCode.UNAVAILABLE, grpc.StatusCode.CANCELLED)


def test_the_same_frame_over_stream_and_call_has_the_same_answer():
    with served() as (_, channel):
        once = rpc_client.document(rpc_client.stub(channel).Deform(QUESTION))
        robot = Robot(channel)
        robot.send(frame(0))
        streamed = rpc_client.document(robot.next().answer)
        robot.hang_up()
    for name in ("request_id", "timing_ms"):
        del once[name], streamed[name]
    assert streamed == once
