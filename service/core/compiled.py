"""Loops that NumPy would need many passes for, compiled by Numba on first use and kept for the next process."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba

Kernel = TypeVar("Kernel", bound=Callable[..., Any])


def compiled(function: Kernel) -> Kernel:
    """Compile a function of numbers and arrays to machine code; its annotations are for the reader.

    The code is kept in `__pycache__`, or in the user's cache where that cannot be written, so that of many processes
    only the first compiles, and that only once; NUMBA_CACHE_DIR names another place. Where nothing can be written at
    all, every process compiles for itself. Other threads run meanwhile: kernels touch no Python object.
    """
    # the test run wraps every function in a check of its types, which the compiler cannot see through
    plain = inspect.unwrap(function)
    options: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "nogil": True}
    try:
        kernel = numba.njit(cache=True, **options)(plain)
    except RuntimeError:  # no place to keep the code in, as on a file system that is read only
        kernel = numba.njit(**options)(plain)
    return cast(Kernel, kernel)
