"""Sparse Cholesky factors behind one interface: MKL PARDISO where it is installed, SuperLU otherwise."""

from __future__ import annotations

import copy
import warnings
import weakref
from functools import cache
from typing import Any, Protocol, runtime_checkable

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float, Float64
from scipy.sparse.linalg import splu


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
        like: A factor on the same pattern, whose ordering is taken.
    """

    def __init__(self, upper: sp.csr_array, like: PardisoFactor | None = None) -> None:
        # finding the library walks the installation, which takes longer than a factor: copy one that found it
        self._solver: Any = copy.copy(_found_solver())
        self._solver.pt = np.zeros_like(self._solver.pt)
        self._solver.iparm = np.zeros_like(self._solver.iparm)
        self._solver.perm = np.zeros(upper.shape[0], np.int32) if like is None else like._solver.perm
        self._solver.set_matrix_type(2)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            self._solver.set_iparm(1, 1)  # take the settings below instead of the defaults
            self._solver.set_iparm(2, 2)  # METIS nested dissection
            self._solver.set_iparm(5, 2 if like is None else 1)  # write the ordering into `perm`, or read it there
            self._solver.set_iparm(8, 0)  # no iterative refinement: Newton's method is its own
            self._solver.set_iparm(24, 1)
            self._solver.set_iparm(28, int(like is not None))  # single precision
        self._upper = upper.copy() if like is None else upper.astype(np.float32)
        self._empty = np.zeros((upper.shape[0], 1), self._upper.dtype)
        # MKL keeps the factor outside Python's memory: free it with this object
        self._finalizer = weakref.finalize(self, _release, self._solver, upper.shape[0])
        self._call(11, self._empty)
        if like is None:
            self.refactor(upper.data)

    def refactor(self, values: Float64[np.ndarray, " nonzeros"]) -> None:
        """See `Factor.refactor`."""
        self._upper.data = np.ascontiguousarray(values, self._upper.dtype)
        self._call(22, self._empty)

    def solve(self, rhs: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, "n k"]:
        """See `Factor.solve`."""
        return np.asarray(self._call(33, np.asfortranarray(rhs, self._upper.dtype)), np.float64)

    def twin(self) -> PardisoFactor:
        """See `Factor.twin`: in single precision, two thirds of the time."""
        return PardisoFactor(self._upper, self)

    def _call(self, phase: int, rhs: Float[np.ndarray, "n k"]) -> Any:
        from pypardiso.pardiso_wrapper import PyPardisoError

        self._solver.set_phase(phase)
        try:
            return self._solver._call_pardiso(self._upper, rhs)
        except PyPardisoError as error:
            if error.value == -4:
                raise NotPositiveDefinite("the matrix is not positive definite") from error
            raise


@cache
def _found_solver() -> Any:
    from pypardiso import PyPardisoSolver

    return PyPardisoSolver()


def _release(solver: Any, size: int) -> None:
    solver.set_phase(-1)
    solver._call_pardiso(sp.csr_array((size, size)), np.zeros((size, 1)))


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
