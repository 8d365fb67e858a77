"""Waiting for what a test needs to have come about, on however slow a machine, in place of a time that should do."""

from __future__ import annotations

import time
from collections.abc import Callable

import httpx

PATIENCE_S = 30.0
"""What takes longer never comes."""


def until(condition: Callable[[], bool], timeout_s: float = PATIENCE_S) -> bool:
    """Whether it came to that."""
    end = time.monotonic() + timeout_s
    while not (found := condition()) and time.monotonic() < end:
        time.sleep(0.02)
    return found


def metric(url: str, name: str) -> float:
    """Sum of a metric of a service over its labels; `name` may hold the first of them."""
    lines = httpx.get(f"{url}/metrics").text.splitlines()
    return sum(float(line.split()[-1]) for line in lines if line.startswith(name))


def queue_depth(url: str) -> int:
    """Requests that wait in a service."""
    return int(metric(url, "physnet_queue_depth"))
