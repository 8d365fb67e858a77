"""Loops that NumPy would need many passes for, compiled by Numba on first use and kept for the next process."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import cpu, event, options

Kernel = TypeVar("Kernel", bound=Callable[..., Any])

# the compiler knows how to use this promise, the decorator does not pass it on
cpu.CPUTargetOptions.noalias = options.TargetOptions.Mapping("noalias")  # type: ignore[no-untyped-call]


def compiled(function: Kernel, apart: bool = False, reordered: bool = False) -> Kernel:
    """Compile a function of numbers and arrays to machine code; its annotations are for the reader.

    The code is kept in `__pycache__`, or in the user's cache where that cannot be written, so that of many processes
    only the first compiles, and that only once; NUMBA_CACHE_DIR names another place. Where nothing can be written at
    all, every process compiles for itself. Other threads run meanwhile: kernels touch no Python object.

    Args:
        function: To be compiled.
        apart: A promise that no array that it writes to shares memory with another of its arguments: short loops over
            many arrays need not look whether they do.
        reordered: Sums may be added up in another order than written, eight at once.
    """
    # the test run wraps every function in a check of its types, which the compiler cannot see through
    plain = inspect.unwrap(function)
    flags = {"contract", "reassoc"} if reordered else {"contract"}
    settings: dict[str, Any] = {"error_model": "numpy", "fastmath": flags, "nogil": True}
    if apart:
        settings["noalias"] = True
    kernel: Any
    try:
        kernel = numba.njit(cache=True, **settings)(plain)
        index = kernel._cache._cache_file
        index._source_stamp = (index._source_stamp, _imported(plain.__globals__))
    except RuntimeError:  # no place to keep the code in, as on a file system that is read only
        kernel = numba.njit(**settings)(plain)
    return cast(Kernel, kernel)


def _imported(names: Mapping[str, Any]) -> str:
    """A digest of what is compiled into a module's kernels from elsewhere: kernels that they call, and constants.

    Numba looks at the file of a kernel alone and would go on with the code of yesterday where another file changed.
    """
    digest = hashlib.sha256()
    value: Any
    for name, value in sorted(names.items()):
        if isinstance(value, numba.core.registry.CPUDispatcher):
            index = getattr(getattr(value, "_cache", None), "_cache_file", None)
            digest.update(repr((name, index and index._source_stamp)).encode())
        elif isinstance(value, np.ndarray):
            digest.update(name.encode() + value.tobytes())
        elif all(isinstance(one, (int, float, np.number)) for one in (value if isinstance(value, tuple) else (value,))):
            digest.update(repr((name, value)).encode())
    return digest.hexdigest()


@contextmanager
def on_compiling(tell: Callable[[], None]) -> Iterator[None]:
    """Call a function once, before the first kernel that is compiled meanwhile; none is where all can be loaded."""
    with event.install_listener("numba:compile", _First(tell)):
        yield


class _First(event.Listener):
    def __init__(self, tell: Callable[[], None]) -> None:
        self._tell = tell
        self._told = False

    def on_start(self, _: object) -> None:
        if not self._told:
            self._told = True
            self._tell()

    def on_end(self, _: object) -> None:
        pass
