"""The queue in front of the workers: order, refusals, cancellation, shutdown, and that nothing kills a worker."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Awaitable, Callable

import numpy as np
import pytest

from service.core.errors import DeadlineExceeded, EmptyObject, Overloaded
from service.core.materials import Material
from service.core.messages import DeformRequest, DeformResult, KnownShape
from service.scheduler import Answer, Overtaken, Scheduler
from tests.service.fakes import FakePredictor


def ask(name: str = "a") -> DeformRequest:
    return DeformRequest(KnownShape(b"", 1.0, np.eye(4)), Material(1.0, 0.3, name), ())


def soon(seconds: float = 10.0) -> float:
    return time.monotonic() + seconds


class Gate:
    """Holds the worker inside `predict` until opened."""

    def __init__(self) -> None:
        self.entered = threading.Event()
        self.open = threading.Event()

    def __call__(self, _: DeformRequest) -> None:
        self.entered.set()
        assert self.open.wait(10)


def run(
    test: Callable[[Scheduler, FakePredictor, Gate], Awaitable[None]], queue_size: int = 2, gate: Gate | None = None,
    workers: int = 1,
) -> FakePredictor:  # fmt: skip
    predictor = FakePredictor(gate) if gate else FakePredictor()

    async def main() -> None:
        scheduler = Scheduler(predictor, queue_size, workers)
        try:
            await test(scheduler, predictor, gate or Gate())
        finally:
            if gate:
                gate.open.set()
            await scheduler.close(5.0)

    asyncio.run(main())
    return predictor


async def in_worker(gate: Gate) -> None:
    await asyncio.to_thread(gate.entered.wait, 10)


def test_answers_come_from_one_thread_in_order_of_asking():
    async def test(scheduler, predictor, gate):
        tasks = [asyncio.create_task(scheduler.submit(ask(name), soon())) for name in "abc"]
        while not predictor.asked or scheduler.queue_depth < 2:  # the first is begun, the others wait
            await asyncio.sleep(0.001)
        await asyncio.sleep(0.02)  # far longer than the first waited for its thread
        gate.open.set()
        answers = await asyncio.gather(*tasks)
        assert all(answer.result.model_name == "fake" for answer in answers)
        assert answers[2].queued_s > answers[0].queued_s and answers[2].queued_s > 0.02

    predictor = run(test, queue_size=3, gate=Gate())
    assert [request.material.name for request in predictor.asked] == ["a", "b", "c"]
    assert predictor.threads == {"inference-0"}


def test_the_worker_makes_the_reply_of_an_answer_and_what_that_raises_is_the_answer():
    async def test(scheduler: Scheduler, predictor: FakePredictor, gate: Gate) -> None:
        def reply(answer: Answer[DeformResult]) -> tuple[str, float, str]:
            return answer.result.model_name, answer.queued_s, threading.current_thread().name

        def broken(answer: Answer[DeformResult]) -> None:
            raise EmptyObject(f"Nothing to say of {answer.result.model_name}.")

        place = scheduler.place()
        for answer in (await scheduler.submit(ask(), soon(), reply), await place.offer(ask(), soon(), reply)):
            assert answer.result == ("fake", answer.queued_s, "inference-0")
        with pytest.raises(EmptyObject, match="Nothing to say of fake"):
            await scheduler.submit(ask(), soon(), broken)
        with pytest.raises(EmptyObject, match="Nothing to say of fake"):
            await place.offer(ask(), soon(), broken)

    assert len(run(test).asked) == 4


def test_a_full_queue_refuses_with_a_time_to_come_back():
    async def test(scheduler, predictor, gate):
        running = asyncio.create_task(scheduler.submit(ask("running"), soon()))
        await in_worker(gate)
        waiting = [asyncio.create_task(scheduler.submit(ask(), soon())) for _ in range(2)]
        await asyncio.sleep(0)
        assert scheduler.queue_depth == 2
        with pytest.raises(Overloaded) as caught:
            await scheduler.submit(ask("refused"), soon())
        assert 0.0 < caught.value.retry_after_s < 10.0
        gate.open.set()
        # The refused one cost the others nothing.
        await asyncio.gather(running, *waiting)

    predictor = run(test, queue_size=2, gate=Gate())
    assert len(predictor.asked) == 3


def test_a_deadline_that_passes_in_the_queue_costs_no_inference():
    async def test(scheduler, predictor, gate):
        running = asyncio.create_task(scheduler.submit(ask("running"), soon()))
        await in_worker(gate)
        late = asyncio.create_task(scheduler.submit(ask("late"), soon(0.05)))
        await asyncio.sleep(0.1)
        gate.open.set()
        with pytest.raises(DeadlineExceeded):
            await late
        await running

    predictor = run(test, gate=Gate())
    assert [request.material.name for request in predictor.asked] == ["running"]


def test_a_deadline_already_past_is_refused_at_once():
    async def test(scheduler, predictor, gate):
        with pytest.raises(DeadlineExceeded):
            await scheduler.submit(ask(), time.monotonic() - 1.0)

    assert run(test).asked == []


def test_cancelling_frees_the_place_in_the_queue():
    async def test(scheduler, predictor, gate):
        running = asyncio.create_task(scheduler.submit(ask("running"), soon()))
        await in_worker(gate)
        given_up = asyncio.create_task(scheduler.submit(ask("given up"), soon()))
        await asyncio.sleep(0)
        assert scheduler.queue_depth == 1
        given_up.cancel()
        with pytest.raises(asyncio.CancelledError):
            await given_up
        assert scheduler.queue_depth == 0
        next_one = asyncio.create_task(scheduler.submit(ask("next"), soon()))
        gate.open.set()
        await asyncio.gather(running, next_one)

    predictor = run(test, queue_size=1, gate=Gate())
    assert [request.material.name for request in predictor.asked] == ["running", "next"]


def test_cancelling_during_inference_leaves_the_worker_alive():
    async def test(scheduler, predictor, gate):
        running = asyncio.create_task(scheduler.submit(ask("running"), soon()))
        await in_worker(gate)
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        gate.open.set()
        assert (await scheduler.submit(ask("next"), soon())).result.model_name == "fake"

    assert len(run(test, gate=Gate()).asked) == 2


@pytest.mark.parametrize(
    ("error", "expected"),
    [
        (EmptyObject("nothing there"), EmptyObject),
        (RuntimeError("bug"), RuntimeError),
        (MemoryError(), MemoryError),
        # As itself it would end the event loop that awaits the answer.
        (SystemExit(3), RuntimeError),
    ],
)
def test_the_worker_survives_whatever_a_request_provokes(error, expected):
    def react(request):
        if request.material.name == "bad":
            raise error

    async def test(scheduler, predictor, gate):
        predictor.react = react
        good, bad, after = await asyncio.gather(
            *(scheduler.submit(ask(name), soon()) for name in ("good", "bad", "after")), return_exceptions=True
        )
        assert type(bad) is expected
        assert good.result.model_name == after.result.model_name == "fake"

    run(test, queue_size=3)


def test_closing_answers_what_was_accepted_and_takes_nothing_more():
    async def test(scheduler, predictor, gate):
        accepted = [asyncio.create_task(scheduler.submit(ask(), soon())) for _ in range(2)]
        await in_worker(gate)
        closing = asyncio.create_task(scheduler.close(10.0))
        await asyncio.sleep(0.05)
        with pytest.raises(Overloaded):
            await scheduler.submit(ask("too late"), soon())
        gate.open.set()
        await closing
        assert len(await asyncio.gather(*accepted)) == 2

    assert len(run(test, gate=Gate()).asked) == 2


def test_closing_refuses_what_does_not_fit_in_the_grace():
    async def test(scheduler, predictor, gate):
        stuck = asyncio.create_task(scheduler.submit(ask("stuck"), soon()))
        await in_worker(gate)
        waiting = asyncio.create_task(scheduler.submit(ask("waiting"), soon()))
        await asyncio.sleep(0)
        began = time.monotonic()
        await scheduler.close(0.1)
        assert time.monotonic() - began < 3.0
        with pytest.raises(Overloaded):
            await waiting
        gate.open.set()
        await stuck

    assert [request.material.name for request in run(test, gate=Gate()).asked] == ["stuck"]


def test_the_wait_that_is_told_follows_how_long_predictions_take():
    async def test(scheduler, predictor, gate):
        predictor.react = lambda request: time.sleep(0.2)
        for _ in range(3):
            await scheduler.submit(ask(), soon())
        tasks = [asyncio.create_task(scheduler.submit(ask(), soon())) for _ in range(2)]
        await asyncio.sleep(0)
        with pytest.raises(Overloaded) as caught:
            await scheduler.submit(ask(), soon())
        # One waits and each takes about 0.2 s; the first guess alone would say 0.1 s.
        assert 0.15 < caught.value.retry_after_s < 2.0
        await asyncio.gather(*tasks)

    run(test, queue_size=1)


def test_what_is_newer_takes_the_place_of_what_waits_and_not_of_what_is_being_answered():
    async def test(scheduler: Scheduler, predictor: FakePredictor, gate: Gate) -> None:
        place = scheduler.place()
        running = place.offer(ask("a"), soon())
        await in_worker(gate)
        waiting = place.offer(ask("b"), soon())
        other = asyncio.ensure_future(scheduler.submit(ask("c"), soon()))
        await asyncio.sleep(0)
        newest = place.offer(ask("d"), soon())
        with pytest.raises(Overtaken):
            await waiting
        assert scheduler.queue_depth == 2
        gate.open.set()
        await asyncio.gather(running, newest, other)

    predictor = run(test, gate=Gate())
    assert [request.material.name for request in predictor.asked] == ["a", "d", "c"]


def test_an_offer_that_is_refused_leaves_what_waits_where_it_is():
    async def test(scheduler: Scheduler, predictor: FakePredictor, gate: Gate) -> None:
        place = scheduler.place()
        running = place.offer(ask("a"), soon())
        await in_worker(gate)
        waiting = place.offer(ask("b"), soon())
        with pytest.raises(DeadlineExceeded):
            place.offer(ask("late"), time.monotonic() - 1.0)
        gate.open.set()
        await asyncio.gather(running, waiting)

    predictor = run(test, gate=Gate())
    assert [request.material.name for request in predictor.asked] == ["a", "b"]


def test_leaving_gives_the_place_up_once_and_for_all():
    async def test(scheduler: Scheduler, predictor: FakePredictor, gate: Gate) -> None:
        place = scheduler.place()
        running = place.offer(ask("a"), soon())
        await in_worker(gate)
        waiting = place.offer(ask("b"), soon())
        place.leave()
        place.leave()
        assert waiting.cancelled()
        assert scheduler.queue_depth == 0
        gate.open.set()
        await running

    assert len(run(test, gate=Gate()).asked) == 1


def test_each_worker_answers_one_at_a_time():
    together = threading.Barrier(2, timeout=10)

    async def test(scheduler: Scheduler, predictor: FakePredictor, gate: Gate) -> None:
        # Neither passes the barrier unless both are inside at once.
        predictor.react = lambda request: together.wait() and None
        await asyncio.gather(*(scheduler.submit(ask(name), soon()) for name in "abcd"))

    assert run(test, workers=2).threads == {"inference-0", "inference-1"}


def test_those_being_answered_take_no_place_in_the_queue():
    async def test(scheduler: Scheduler, predictor: FakePredictor, gate: Gate) -> None:
        accepted = [asyncio.create_task(scheduler.submit(ask(), soon())) for _ in range(3)]
        await in_worker(gate)
        with pytest.raises(Overloaded):
            await scheduler.submit(ask("refused"), soon())
        gate.open.set()
        await asyncio.gather(*accepted)

    assert len(run(test, queue_size=1, gate=Gate(), workers=2).asked) == 3


def test_a_stream_is_answered_in_its_own_order_by_several_workers():
    slow, told = threading.Event(), []

    def react(request: DeformRequest) -> None:
        if request.material.name == "a":
            assert slow.wait(10)

    async def test(scheduler: Scheduler, predictor: FakePredictor, gate: Gate) -> None:
        predictor.react = react
        place = scheduler.place()
        futures = {}
        for name in "abcd":
            futures[name] = place.offer(ask(name), soon())
            futures[name].add_done_callback(lambda _, name=name: told.append(name))
            while scheduler.queue_depth:  # the second worker takes each, and is done with it long before the first
                await asyncio.sleep(0.001)
        other = scheduler.place()
        await other.offer(ask("of another stream"), soon())
        assert told == []
        slow.set()
        await asyncio.gather(*futures.values())

    run(test, queue_size=4, workers=2)
    assert told == ["a", "b", "c", "d"]


def test_a_frame_that_is_overtaken_hears_of_it_before_those_being_answered_are_done():
    async def test(scheduler: Scheduler, predictor: FakePredictor, gate: Gate) -> None:
        place = scheduler.place()
        running = [place.offer(ask("a"), soon())]
        await in_worker(gate)
        running.append(place.offer(ask("b"), soon()))
        while scheduler.queue_depth:
            await asyncio.sleep(0.001)
        waiting = place.offer(ask("c"), soon())
        newest = place.offer(ask("d"), soon())
        with pytest.raises(Overtaken):
            await waiting
        assert not any(future.done() for future in running)
        gate.open.set()
        await asyncio.gather(*running, newest)

    assert sorted(request.material.name for request in run(test, gate=Gate(), workers=2).asked) == ["a", "b", "d"]
