"""Draws that cost nothing, in a module that worker processes can import."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path

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


def mortal(folder: str, index: int) -> dict[str, np.ndarray]:
    """The process that draws group 20 first dies of it, as a machine of a cluster does; whoever comes next does not."""
    if index == 20:
        try:
            (Path(folder) / "died").touch(exist_ok=False)
        except FileExistsError:
            return quick(index)
        os.kill(os.getpid(), signal.SIGKILL)
    return quick(index)
