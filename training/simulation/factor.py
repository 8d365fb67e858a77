"""Sparse Cholesky factors behind one interface: MKL PARDISO where it is installed, SuperLU otherwise."""

from __future__ import annotations

import copy
import ctypes
import weakref
from functools import cache
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Float64, Int32, Int64
from scipy.sparse.linalg import splu

_SYMMETRIC_POSITIVE = 2
"""PARDISO's type of matrix."""
_SETTINGS = {1: 1, 2: 2, 24: 1, 37: -70}
"""PARDISO's iparm, counted from one, where it is not zero: take these and no defaults; order by nested dissection;
factorise in two levels; take rows that are alike in 70 % of their places, as those of a node are, for one block, which
halves the time of ordering. No iterative refinement: Newton's method is its own."""
_NOT_POSITIVE = -4
"""Its error where a pivot is not positive."""
_NONE = np.zeros((0, 1))


class NotPositiveDefinite(ArithmeticError):
    """The matrix has a direction of zero or negative curvature."""


@runtime_checkable
class Factor(Protocol):
    """A factorised symmetric positive definite matrix."""

    def solve(self, rhs: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, "n k"]:
        """Solution for every column of the right-hand side."""

    def refactor(self, values: Float64[np.ndarray, " nonzeros"]) -> None:
        """Factorise other values on the same sparsity pattern, reusing the ordering.

        Raises:
            NotPositiveDefinite: a pivot is not positive.
        """

    def twin(self) -> Factor:
        """Another factor on the same pattern, as good as an approximate inverse needs; `refactor` gives it values."""


def factorise(upper: sp.csr_array, backend: str = "auto") -> Factor:
    """Factorise a symmetric positive definite matrix given by its upper triangle.

    Args:
        upper: Upper triangle with sorted columns; its values are read, not kept.
        backend: `pardiso`, `superlu`, or `auto` for the first that works here.

    Raises:
        NotPositiveDefinite: a pivot is not positive.
    """
    if backend in ("auto", "pardiso"):
        try:
            return PardisoFactor(upper)
        except ImportError:
            if backend == "pardiso":
                raise
    return SuperLUFactor(upper)


class PardisoFactor:
    """Cholesky factor by Intel MKL PARDISO, matrix type 2 (real symmetric positive definite).

    Args:
        upper: Upper triangle; empty values, in single precision, where `like` is given.
        like: A factor on the same pattern.
    """

    def __init__(self, upper: sp.csr_array, like: PardisoFactor | None = None) -> None:
        self._library = _library()
        self._handle, self._settings = np.zeros(64, np.int64), np.zeros(64, np.int32)
        for number, value in _SETTINGS.items():
            self._settings[number - 1] = value
        if like is not None:
            # single precision; refactored often, it earns the better ordering that single rows get
            self._settings[27], self._settings[36] = 1, 0
        self._upper = upper.copy() if like is None else upper.astype(np.float32)
        # counted from one
        self._starts, self._columns = upper.indptr.astype(np.int32) + 1, upper.indices.astype(np.int32) + 1
        # MKL keeps the factor outside Python's memory: free it with this object
        self._finalizer = weakref.finalize(self, _release, self._library, self._handle, self._settings)
        self._call(11)
        if like is None:
            self.refactor(upper.data)

    def refactor(self, values: Float64[np.ndarray, " nonzeros"]) -> None:
        """See `Factor.refactor`."""
        self._upper.data = np.ascontiguousarray(values, self._upper.dtype)
        self._call(22)

    def solve(self, rhs: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, "n k"]:
        """See `Factor.solve`; columns lie together in memory, and such a right-hand side is not copied."""
        columns = np.asfortranarray(rhs, self._upper.dtype)
        solution = np.empty_like(columns)
        self._call(33, columns, solution)
        return np.asarray(solution, np.float64)

    def twin(self) -> PardisoFactor:
        """See `Factor.twin`: in single precision, two thirds of the time."""
        return PardisoFactor(self._upper, self)

    def _call(
        self, phase: int, rhs: Float[np.ndarray, "n k"] = _NONE, solution: Float[np.ndarray, "n k"] = _NONE
    ) -> None:
        error = _pardiso(
            self._library, self._handle, self._settings, phase, self._upper.data, self._starts, self._columns, rhs,
            solution,
        )  # fmt: skip
        if error == _NOT_POSITIVE:
            raise NotPositiveDefinite("the matrix is not positive definite")
        if error:
            raise RuntimeError(f"MKL PARDISO failed in phase {phase} with error {error}; see its documentation")


def _pardiso(
    library: Any,
    handle: Int64[np.ndarray, " 64"],
    settings: Int32[np.ndarray, " 64"],
    phase: int,
    values: Float[np.ndarray, " nonzeros"],
    starts: Int32[np.ndarray, " rows"],
    columns: Int32[np.ndarray, " nonzeros"],
    rhs: Float[np.ndarray, "n k"],
    solution: Float[np.ndarray, "n k"],
) -> int:
    """One call of the library, pypardiso's less its copies; returns the error, 0 for none."""
    error, one, none = ctypes.c_int32(0), ctypes.c_int32(1), ctypes.c_int32(0)

    def integers(array: Int32[np.ndarray, " n"]) -> Any:
        return array.ctypes.data_as(ctypes.POINTER(ctypes.c_int32))

    library(
        handle.ctypes.data_as(ctypes.POINTER(ctypes.c_int64)), one, one, ctypes.c_int32(_SYMMETRIC_POSITIVE),
        ctypes.c_int32(phase), ctypes.c_int32(max(len(starts) - 1, 0)), values.ctypes.data_as(ctypes.c_void_p),
        integers(starts), integers(columns), None, ctypes.c_int32(rhs.shape[1]), integers(settings), none,
        rhs.ctypes.data_as(ctypes.c_void_p), solution.ctypes.data_as(ctypes.c_void_p), ctypes.byref(error),
    )  # fmt: skip
    return int(error.value)


@cache
def _library() -> Any:
    # finding the library walks the installation, which takes longer than a factor: do it once
    from pypardiso import PyPardisoSolver

    return PyPardisoSolver()._mkl_pardiso


def _release(library: Any, handle: Int64[np.ndarray, " 64"], settings: Int32[np.ndarray, " 64"]) -> None:
    nothing = np.zeros(0, np.int32)
    _pardiso(library, handle, settings, -1, np.zeros(0), nothing, nothing, _NONE, _NONE)


class SuperLUFactor:
    """LU factor by SciPy's SuperLU with a symmetric ordering: slower, but always there."""

    def __init__(self, upper: sp.csr_array) -> None:
        self._upper = upper.copy()
        self.refactor(upper.data)

    def twin(self) -> SuperLUFactor:
        """See `Factor.twin`."""
        other = copy.copy(self)
        other._upper = self._upper.copy()
        return other

    def refactor(self, values: Float64[np.ndarray, " nonzeros"]) -> None:
        """See `Factor.refactor`."""
        self._upper.data = np.ascontiguousarray(values)
        full = (self._upper + sp.triu(self._upper, 1).T).tocsc()
        options = {"SymmetricMode": True}
        self._lu: Any = splu(full, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
        if not (self._lu.U.diagonal() > 0.0).all():
            raise NotPositiveDefinite("the matrix is not positive definite")

    def solve(self, rhs: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, "n k"]:
        """See `Factor.solve`."""
        return np.asarray(self._lu.solve(np.ascontiguousarray(rhs)))
