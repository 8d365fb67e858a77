"""Threads that help the one that answers a request, and the cores they run on.

Linux may wake a helper on the core of who wakes it, though another is idle: a network on two threads then takes as
long as on one (measured: docs/performance.md). So helpers are kept off the core of the request they help. Elsewhere
than on Linux nothing is done.
"""

from __future__ import annotations

import contextlib
import ctypes
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

NAME = "physnet-helper"
"""Of the threads of libraries, which do not tell their numbers; a thread has the name of the one that started it."""

_TASKS = Path("/proc/self/task")
_OWN_NAME = Path("/proc/thread-self/comm")


@contextlib.contextmanager
def starting() -> Iterator[None]:
    """Threads that the calling one starts meanwhile are helpers."""
    try:
        before = _OWN_NAME.read_text().rstrip("\n")
        _OWN_NAME.write_text(NAME)
    except OSError:
        yield
        return
    try:
        yield
    finally:
        _OWN_NAME.write_text(before)


class Helpers:
    """The helpers that this process has now.

    Args:
        others: Numbers of threads (`threading.get_native_id`) that were not found by their name.
    """

    def __init__(self, others: Iterable[int] = ()) -> None:
        self.ids = frozenset(others) | _named()
        self._kept_off: int | None = None

    def keep_off(self) -> None:
        """Have them run on the cores that the calling thread does not run on now, where it may use several."""
        here = _core()
        if here is None or here == self._kept_off:
            return
        others = os.sched_getaffinity(0) - {here}
        if others:
            self._kept_off = here
            for number in self.ids:
                with contextlib.suppress(OSError):  # it has ended, or may not run there any more
                    os.sched_setaffinity(number, others)


def _named() -> frozenset[int]:
    found = set()
    for task in _TASKS.glob("*/comm"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            if task.read_text().rstrip("\n") == NAME:
                found.add(int(task.parent.name))
    return frozenset(found)


def _core() -> int | None:
    """The core that the calling thread runs on; None where the system does not tell."""
    if not _sched_getcpu:
        return None
    core = int(_sched_getcpu())
    return core if core >= 0 else None


_sched_getcpu = getattr(ctypes.CDLL(None), "sched_getcpu", None) if hasattr(os, "sched_setaffinity") else None
