"""When to ask again: a question changes nothing, so it may be asked twice; a robot in a hurry may not wait for it."""

from __future__ import annotations

import random
import sys
import time
from dataclasses import dataclass, replace

from service.client.errors import ServiceUnreachable, timed_out
from service.core.errors import Overloaded, PhysNetError


@dataclass(frozen=True)
class Retry:
    """How patient a client is.

    Only what a second try can mend is tried again: a connection that broke, and a service that is full, starting or
    stopping. What is wrong with the question itself is raised at once.

    Attributes:
        attempts: Tries in all, at least 1.
        first_s: Longest pause before the second try; doubles with each further one.
        longest_s: Longest pause.
    """

    attempts: int = 4
    first_s: float = 0.05
    longest_s: float = 2.0

    def pause_s(self, tried: int, error: PhysNetError) -> float | None:
        """How long to wait after `tried` tries, None where there is no sense in another.

        An overloaded service is left alone for as long as it asks; what is added on top is drawn at random, so that
        robots turned away together do not come back together.

        Source: "full jitter", Brooker, Exponential Backoff And Jitter, AWS Architecture Blog 2015.
        """
        if tried >= self.attempts or not isinstance(error, Overloaded | ServiceUnreachable):
            return None
        drawn_s = random.uniform(0.0, min(self.longest_s, self.first_s * 2.0 ** min(tried - 1, 30)))
        return drawn_s + (error.retry_after_s if isinstance(error, Overloaded) else 0.0)

    def pause_or_raise_s(self, tried: int, error: PhysNetError) -> float:
        """`pause_s`, raising `error` where there is no sense in another try."""
        pause_s = self.pause_s(tried, error)
        if pause_s is None:
            raise error
        return pause_s

    def without_end(self) -> Retry:
        """For a stream, which outlives a service that is started again."""
        return replace(self, attempts=sys.maxsize)


class Attempts:
    """One call's tries within one deadline.

    Args:
        retry: How patient.
        timeout_s: For all tries and pauses together.
    """

    def __init__(self, retry: Retry, timeout_s: float) -> None:
        self._retry = retry
        self._timeout_s = timeout_s
        self._end = time.monotonic() + timeout_s
        self._tried = 0

    def left_s(self) -> float:
        """Seconds until the deadline.

        Raises:
            DeadlineExceeded: None are left.
        """
        left_s = self._end - time.monotonic()
        if left_s <= 0.0:
            raise timed_out(self._timeout_s)
        return left_s

    def pause_s(self, error: PhysNetError) -> float:
        """Seconds to wait before the next try.

        Raises:
            PhysNetError: `error` itself, where no further try has a chance before the deadline.
        """
        self._tried += 1
        pause_s = self._retry.pause_or_raise_s(self._tried, error)
        if time.monotonic() + pause_s >= self._end:
            raise error
        return pause_s
