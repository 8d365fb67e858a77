"""A bounded queue in front of a few worker threads: inference neither blocks the event loop nor waits for itself.

An answer keeps one core busy, as its networks and loops are too small to share, so there is a worker for each core.
What cannot be answered in time is refused before it costs anything: when the queue is full, and when the deadline has
passed by the time a worker would start. A stream of frames has one place in the queue, in which the newest frame waits.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeAlias, TypeVar, runtime_checkable

from service.core.errors import DeadlineExceeded, Overloaded
from service.core.messages import DeformRequest, DeformResult

log = logging.getLogger(__name__)

Result = TypeVar("Result")

FIRST_GUESS_S = 0.05
"""Time of one prediction, assumed until one has been measured."""

SMOOTHING = 0.2
"""Weight of the newest prediction in the running mean: follows a change of load within about five requests."""


@runtime_checkable
class Predictor(Protocol):
    """What the workers run: `service.pipeline.Pipeline`."""

    def predict(self, request: DeformRequest) -> DeformResult:
        """Answer one request, beside others in other threads; raises errors of `service.core.errors`."""


class Overtaken(Exception):
    """A newer frame of the same stream has taken the place of this one; nothing was computed."""


@dataclass(frozen=True)
class Answer(Generic[Result]):
    """Attributes:
    result: What the worker returned.
    queued_s: How long the request waited for a worker.
    """

    result: Result
    queued_s: float


Then: TypeAlias = Callable[[Answer[DeformResult]], Any]
"""What the worker makes of an answer before it is told, such as a reply: it has the answer in its core's cache."""


def as_it_is(answer: Answer[DeformResult]) -> DeformResult:
    """For whoever wants to be told the answer itself."""
    return answer.result


class _Job(Generic[Result]):
    """`work` is given how long it has waited, in seconds."""

    def __init__(self, work: Callable[[float], Result], deadline: float, loop: asyncio.AbstractEventLoop) -> None:
        self.work = work
        self.deadline = deadline
        self.loop = loop
        self.future: asyncio.Future[Answer[Result]] = loop.create_future()
        self.submitted = time.monotonic()
        self.after: asyncio.Future[Any] | None = None
        """Of the same stream, and begun before: its outcome is told first."""

    def settle(self, outcome: Answer[Result] | BaseException) -> None:
        """Hand the outcome to the event loop; nobody may be waiting for it any more."""
        try:
            self.loop.call_soon_threadsafe(self._settle_here, outcome)
        except RuntimeError:
            log.debug("the event loop closed before a reply was ready")

    def _settle_here(self, outcome: Answer[Result] | BaseException) -> None:
        if self.future.done():
            return
        if self.after is not None and not self.after.done() and not isinstance(outcome, Overtaken):
            self.after.add_done_callback(lambda _: self._settle_here(outcome))
            return
        self.after = None
        if isinstance(outcome, BaseException):
            self.future.set_exception(outcome)
        else:
            self.future.set_result(outcome)


class Scheduler:
    """First come, first served, by dedicated threads.

    Args:
        predictor: Runs in all of them at once.
        queue_size: Requests that may wait; those being answered do not count.
        workers: Threads, and so requests that are answered at once.
    """

    def __init__(self, predictor: Predictor, queue_size: int, workers: int = 1) -> None:
        self._predictor = predictor
        self._queue_size = queue_size
        self._waiting: deque[_Job[Any]] = deque()
        self._changed = threading.Condition()
        self._closed = False
        self._busy = 0
        self._mean_s = FIRST_GUESS_S
        # Daemons: a prediction cannot be interrupted, and a stuck one does not hold up the exit.
        self._threads = [
            threading.Thread(target=self._work, name=f"inference-{i}", daemon=True) for i in range(workers)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def queue_depth(self) -> int:
        """Requests that wait for a worker."""
        return len(self._waiting)

    async def submit(self, request: DeformRequest, deadline: float, then: Then = as_it_is) -> Answer[Any]:
        """Answer a request with what `then` makes of the answer, in the same thread; raises as `call` does."""
        return await self._done(self._job(request, deadline, then))

    async def call(self, work: Callable[[], Result], deadline: float) -> Answer[Result]:
        """Do something in a worker thread. Cancelling the caller frees its place in the queue at once.

        Args:
            work: What to do.
            deadline: Time of `time.monotonic()` at which it must have been begun.

        Raises:
            Overloaded: The queue is full or the service is shutting down.
            DeadlineExceeded: The deadline passed before inference.
            PhysNetError: What `work` found wrong with the request.
        """
        return await self._done(_Job(lambda _: work(), deadline, asyncio.get_running_loop()))

    def _job(self, request: DeformRequest, deadline: float, then: Then) -> _Job[Any]:
        def work(queued_s: float) -> Any:
            return then(Answer(self._predictor.predict(request), queued_s))

        return _Job(work, deadline, asyncio.get_running_loop())

    async def _done(self, job: _Job[Result]) -> Answer[Result]:
        self._enter(job)
        try:
            return await job.future
        finally:
            self._forget(job)

    def place(self) -> Place:
        """A place in the queue for one stream."""
        return Place(self)

    def _enter(self, job: _Job[Any], instead_of: _Job[Any] | None = None) -> bool:
        """Put a job where another one waits, if it still does, else at the end; returns whether it did."""
        if job.submitted >= job.deadline:
            raise _too_late(0.0)
        with self._changed:
            if self._closed:
                raise Overloaded("The service is shutting down; try another one.", retry_after_s=1.0)
            if instead_of is not None and instead_of in self._waiting:
                self._waiting[self._waiting.index(instead_of)] = job
                return True
            # Counted together: one that an idle worker is about to take holds no place in the queue.
            inside = len(self._waiting) + self._busy
            if inside >= self._queue_size + len(self._threads):
                retry_after_s = self._mean_s * inside / len(self._threads)
                raise Overloaded(
                    f"{inside} requests are being answered already; try again in {retry_after_s:.2f} s.",
                    retry_after_s=retry_after_s,
                )
            self._waiting.append(job)
            self._changed.notify()
            return False

    def _forget(self, job: _Job[Any]) -> None:
        with self._changed:
            if job in self._waiting:
                self._waiting.remove(job)
                self._changed.notify_all()

    async def close(self, grace_s: float) -> None:
        """Take nothing more in, answer what is waiting for up to `grace_s` seconds and refuse the rest."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        await asyncio.to_thread(self._drain, grace_s)

    def _drain(self, grace_s: float) -> None:
        with self._changed:
            self._changed.wait_for(lambda: not self._waiting and not self._busy, timeout=grace_s)
            left = list(self._waiting)
            self._waiting.clear()
            self._changed.notify_all()
        for job in left:
            job.settle(Overloaded("The service is shutting down; try another one.", retry_after_s=1.0))
        gone = time.monotonic() + 1.0
        for thread in self._threads:
            thread.join(timeout=max(0.0, gone - time.monotonic()))

    def _work(self) -> None:
        while (job := self._next()) is not None:
            started = time.monotonic()
            outcome = self._outcome(job, started)
            finished = time.monotonic()
            # The place is free before the caller hears of it, so that its next request finds it so.
            with self._changed:
                self._busy -= 1
                if isinstance(outcome, Answer):
                    self._mean_s += SMOOTHING * (finished - started - self._mean_s)
                # Workers wait for what comes in; only a stop waits for what is done.
                if self._closed:
                    self._changed.notify_all()
            job.settle(outcome)

    def _next(self) -> _Job[Any] | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._closed)
            if not self._waiting:
                return None
            self._busy += 1
            return self._waiting.popleft()

    def _outcome(self, job: _Job[Result], started: float) -> Answer[Result] | BaseException:
        if job.future.cancelled():
            return asyncio.CancelledError()
        if started >= job.deadline:
            return _too_late(started - job.submitted)
        # Whatever one request provokes is that request's answer: the worker must live for the next one.
        try:
            queued_s = started - job.submitted
            return Answer(job.work(queued_s), queued_s)
        except Exception as error:
            return error
        except BaseException as error:
            # SystemExit and its kind, raised by some library, would end the event loop that awaits the future.
            wrapped = RuntimeError(f"inference raised {type(error).__name__}")
            wrapped.__cause__ = error
            return wrapped


class Place:
    """A stream's one place in the queue: what waits there gives way to what is newer, which keeps the place.

    So a stream has at most one frame waiting, and however fast its frames come, it neither crowds others out nor loses
    its turn. Several workers may have one of its frames each; their answers are told in the order of the frames.
    """

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self._newest: _Job[Any] | None = None

    def offer(
        self, request: DeformRequest, deadline: float, then: Then = as_it_is
    ) -> asyncio.Future[Answer[Any]]:
        """Let a frame wait here; the one that still does is overtaken, and its future raises `Overtaken`.

        What is answered is what `then` makes of the answer in the worker's thread.

        Raises:
            Overloaded: The queue is full or the service is shutting down; what was waiting here still is.
            DeadlineExceeded: The deadline (`time.monotonic()`) has passed already.
        """
        scheduler = self._scheduler
        job = scheduler._job(request, deadline, then)
        if self._newest is not None:
            job.after = self._newest.future
        if scheduler._enter(job, instead_of=self._newest) and self._newest is not None:
            job.after = self._newest.after
            self._newest.settle(Overtaken())
        self._newest = job
        return job.future

    def leave(self) -> None:
        """Give the place up, with whatever waits there."""
        if self._newest is not None:
            self._newest.future.cancel()
            self._scheduler._forget(self._newest)
            self._newest = None


def _too_late(waited_s: float) -> DeadlineExceeded:
    return DeadlineExceeded(
        f"The deadline passed before inference, after {1e3 * waited_s:.0f} ms in the queue; nothing was computed."
    )
