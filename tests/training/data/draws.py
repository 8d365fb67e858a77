"""Draws that cost nothing, in a module that worker processes can import."""

from __future__ import annotations

import time

import numpy as np

from training.data.generate import Dropped


def quick(index: int) -> dict[str, np.ndarray]:
    """Two or three random samples; every fifth draw is dropped."""
    if index % 5 == 3:
        raise Dropped("thin" if index % 2 else "empty")
    rng = np.random.default_rng(np.random.SeedSequence((7, index)))
    return {"value": rng.random((2 + index % 2, 4)), "sample": np.arange(2 + index % 2), "family": np.array("x")}


def slow(index: int) -> dict[str, np.ndarray]:
    """The same, slowly enough to be interrupted."""
    time.sleep(0.05)
    return quick(index)


def broken(index: int) -> dict[str, np.ndarray]:
    raise ZeroDivisionError(f"group {index}")
