"""Work that can be done in parts: how many, and in which thread, is up to whoever calls."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

Work: TypeAlias = Callable[[int, int], None]
"""Work on what is from a first number to before another; parts have nothing to do with each other."""

Spread: TypeAlias = Callable[[Work, int], None]
"""Does work on parts that together are everything from 0 to before a number, and returns when all is done."""


def in_turn(work: Work, end: int) -> None:
    """All of it in one part, here."""
    work(0, end)
