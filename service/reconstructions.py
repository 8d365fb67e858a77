"""Reconstructions that may be asked again: the ones used last, for a bounded time and in a bounded memory."""

from __future__ import annotations

import secrets
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from service.core.errors import ReconstructionGone

Item = TypeVar("Item")


@dataclass
class _Kept(Generic[Item]):
    item: Item
    nbytes: int
    expires: float


class Reconstructions(Generic[Item]):
    """Items by an id that nobody can guess; who holds an id may ask for what it names.

    Any thread may use them.

    Args:
        max_bytes: Together; where it is exceeded, those not used for the longest time go. 0 keeps nothing.
        lifetime_s: Since the last use.
        clock: Seconds that only rise.

    Attributes:
        entries: How many are kept; one whose time is up counts until the next use of any.
        nbytes: Their memory.
        hits: Questions that found theirs.
        misses: Questions that did not.
    """

    def __init__(self, max_bytes: int, lifetime_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self._max_bytes = max_bytes
        self._lifetime_s = lifetime_s
        self._clock = clock
        self._kept: OrderedDict[str, _Kept[Item]] = OrderedDict()
        self._lock = threading.Lock()
        self.nbytes = 0
        self.hits = 0
        self.misses = 0

    @property
    def entries(self) -> int:
        return len(self._kept)

    def keep(self, item: Item, nbytes: int) -> str | None:
        """Keep something of `nbytes` bytes; returns its id, None where it alone is more than may be kept."""
        with self._lock:
            self._drop_expired()
            if nbytes > self._max_bytes:
                return None
            while self.nbytes + nbytes > self._max_bytes:
                self._drop(next(iter(self._kept)))
            reconstruction_id = secrets.token_hex(16)
            self._kept[reconstruction_id] = _Kept(item, nbytes, self._clock() + self._lifetime_s)
            self.nbytes += nbytes
            return reconstruction_id

    def find(self, reconstruction_id: str) -> Item:
        """What is kept under an id, whose time starts again.

        Raises:
            ReconstructionGone: Nothing is, or no longer.
        """
        with self._lock:
            self._drop_expired()
            kept = self._kept.get(reconstruction_id)
            if kept is not None:
                self.hits += 1
                kept.expires = self._clock() + self._lifetime_s
                self._kept.move_to_end(reconstruction_id)
                return kept.item
            self.misses += 1
        raise ReconstructionGone(
            "No reconstruction is kept under this id, or no longer: send the depth frame or the shape again.",
            field="reconstruction_id",
            expected=f"an id used within {self._lifetime_s:g} s" if self._max_bytes else "none: nothing is kept",
            actual=reconstruction_id[:80],
        )

    def _drop_expired(self) -> None:
        now = self._clock()
        # In the order of their last use, which is that of their expiry.
        while self._kept and next(iter(self._kept.values())).expires <= now:
            self._drop(next(iter(self._kept)))

    def _drop(self, reconstruction_id: str) -> None:
        self.nbytes -= self._kept.pop(reconstruction_id).nbytes
