"""Work for the cores that the thread of a request leaves idle."""

from __future__ import annotations

import contextlib
import queue
import threading
import weakref
from collections.abc import Callable, Iterator
from functools import partial
from typing import Any, Generic, TypeVar, cast

from service.core.spread import Spread, Work, in_turn
from service.inference.helpers import Helpers

Result = TypeVar("Result")

LONGEST_S = 1.0
"""That the end waits for what a thread has begun."""


class Once(Generic[Result]):
    """A result that is worked out once, by whichever thread comes first; one that comes meanwhile waits for it.

    Args:
        work: Works it out. What it raises is raised to who asked, and the next one has it tried again.
    """

    def __init__(self, work: Callable[[], Result]) -> None:
        self._work: Callable[[], Result] | None = work
        self._lock = threading.Lock()

    def __call__(self) -> Result:
        with self._lock:
            if self._work is not None:
                self._result = self._work()
                self._work = None  # nor is kept what it was worked out from
            return self._result


class SpareCores:
    """Threads that are kept for work that a request can do without for a while.

    Whoever needs the result asks for it (`Once`) and, if none of the threads has come to it, works it out himself. So
    nobody waits for what waits in a queue: with all threads busy, or none, everything is done in turn. So it is when as
    many requests are answered at once as there are cores: sharing would only cost. The threads end with this object, or
    with the process.

    Args:
        count: Threads: one less than there are cores. 0 does everything in turn.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._requests = 0
        self._lock = threading.Lock()
        # An executor of the standard library needs 35 µs to take one thing in, this 8, and a question offers seven.
        self._offered: queue.SimpleQueue[Once[Any] | None] = queue.SimpleQueue()
        threads = [
            threading.Thread(target=_work_on, args=(self._offered,), name=f"spare-core-{i}", daemon=True)
            for i in range(count)
        ]
        for thread in threads:
            thread.start()
        self._helpers = Helpers(thread.native_id for thread in threads if thread.native_id is not None)
        weakref.finalize(self, _end, self._offered, threads)

    @contextlib.contextmanager
    def answering(self) -> Iterator[None]:
        """While it lasts, a request has a core of its own."""
        with self._lock:
            self._requests += 1
        if self._idle:
            self._helpers.keep_off()
        try:
            yield
        finally:
            with self._lock:
                self._requests -= 1

    @property
    def _idle(self) -> bool:
        return 0 < self._count >= self._requests

    def offer(self, once: Once[Result]) -> Once[Result]:
        """Have something worked out meanwhile, if a thread has time; returns it."""
        if self._idle:
            self._offered.put(once)
        return once

    def spread(self, work: Work, end: int) -> None:
        """`service.core.spread.Spread`: one half here, the other in a thread that has time, or else here, too."""
        if not self._idle or end < 2:
            in_turn(work, end)
            return
        upper = self.offer(Once(partial(work, end // 2, end)))
        work(0, end // 2)
        upper()

    def each(self, work: Callable[[int, Spread], Result], count: int) -> list[Result]:
        """Results for the numbers 0 to before `count`: many are shared out, of a single one its parts may be."""
        if count == 1:
            return [work(0, self.spread)]
        results: list[Result | None] = [None] * count

        def some(first: int, end: int) -> None:
            for i in range(first, end):
                results[i] = work(i, in_turn)

        self.spread(some, count)
        return cast(list[Result], results)


def _work_on(offered: queue.SimpleQueue[Once[Any] | None]) -> None:
    """What each thread does; it does not know its owner, so that it ends with it."""
    while (once := offered.get()) is not None:
        with contextlib.suppress(Exception):  # whoever asks for the result is told
            once()
        del once  # nor is anything kept alive until the next


def _end(offered: queue.SimpleQueue[Once[Any] | None], threads: list[threading.Thread]) -> None:
    """Let them finish what they have begun: a process must not end within a network's run."""
    for _ in threads:
        offered.put(None)
    for thread in threads:
        if thread is not threading.current_thread():
            thread.join(LONGEST_S)
