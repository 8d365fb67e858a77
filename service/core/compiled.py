"""Loops that NumPy would need many passes for, compiled by Numba on first use and kept for the next process."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache, partial
from typing import Any, TypeVar, cast

import llvmlite.binding as llvm
import numba
import numpy as np
from numba.core import cpu, event, options
from numba.core.caching import FunctionCache
from numba.core.runtime.nrt import rtsys

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
        kernel._cache.__class__ = _Kept
        index = kernel._cache._cache_file
        index._source_stamp = (index._source_stamp, _imported(plain.__globals__))
    except RuntimeError:  # no place to keep the code in, as on a file system that is read only
        kernel = numba.njit(**settings)(plain)
    return cast(Kernel, kernel)


class _Kept(FunctionCache):
    """Kept code, loaded without what only compiling needs.

    Numba registers all that it can compile before it loads the first kernel, and reads with each the form in which
    others would take it in. That is two thirds of the time; a process that does compile something does both then.
    """

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            rtsys.initialize(target_context)  # what kernels allocate their arrays with
            with self._guard_against_spurious_io_errors():
                return self._load_bare(sig, target_context)
        except (AttributeError, ImportError, TypeError, ValueError):  # kept in another form, by another Numba
            try:
                return super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
            except (AttributeError, ImportError):  # kept for arguments of a class that is gone since
                self.flush()  # type: ignore[no-untyped-call]
                return None

    def _load_bare(self, sig: Any, target_context: Any) -> Any:
        key = self._index_key(sig, target_context.codegen())  # type: ignore[no-untyped-call]
        data = self._cache_file.load(key)  # type: ignore[no-untyped-call]
        if data is None:
            return None
        (name, kind, (code, for_others)), about, *rest = data
        target_context.codegen()._engine._defined_symbols |= {about.llvm_cpython_wrapper_name, about.llvm_func_name}
        found = self._impl.rebuild(target_context, ((name, kind, (code, _no_functions())), about, *rest))
        found.library._shared_module = None
        found.library._get_module_for_linking = cache(partial(llvm.parse_bitcode, for_others))
        return found


@cache
def _no_functions() -> bytes:
    """Bitcode of an empty module."""
    return bytes(llvm.parse_assembly("").as_bitcode())


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
