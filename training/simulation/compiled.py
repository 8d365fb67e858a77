"""Loops that NumPy would need many passes for, compiled by Numba on first use and kept beside the source."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def compiled(function: Kernel) -> Kernel:
    """Compile a function of numbers and arrays to machine code; its annotations are for the reader.

    The code is kept in `__pycache__`, so that of many worker processes only the first compiles, and that only once.
    """
    # the test run wraps every function in a check of its types, which the compiler cannot see through
    return cast(Kernel, numba.njit(cache=True, error_model="numpy", fastmath={"contract"})(inspect.unwrap(function)))
