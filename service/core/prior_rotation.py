"""Rotations of the cells of a coarse solve: exponential, polar decomposition.

All arrays are laid out components first, (3, 3, …), so that one operation serves all cells and loads.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

Matrices = Float32[np.ndarray, "3 3 *rest"]

_MIN_DETERMINANT = 1e-3
"""A cell squeezed to less than this, or turned inside out, has no rotation of its own."""


class Cofactors:
    """Cofactors (the transposed adjugate) and determinants of matrices that change in place.

    Cofactor (i, j) is m_(i+1)(j+1) m_(i+2)(j+2) − m_(i+1)(j+2) m_(i+2)(j+1), indices modulo three: the matrices are
    kept with their first two rows and columns repeated, so that each of the four factors is a view.

    Attributes:
        matrix: The matrices.
        values: Their cofactors as of the last update.
    """

    def __init__(self, matrices: Matrices) -> None:
        self._cyclic = np.empty((5, 5, *matrices.shape[2:]), np.float32)
        self.matrix: Matrices = self._cyclic[:3, :3]
        self.matrix[...] = matrices
        self.values: Matrices = np.empty_like(matrices, order="C")
        self._minor = np.empty_like(self.values)
        c = self._cyclic
        self._factors = c[1:4, 1:4], c[2:5, 2:5], c[1:4, 2:5], c[2:5, 1:4]

    def update(self) -> Float32[np.ndarray, "*rest"]:
        """Bring the cofactors up to date, and return the determinants."""
        self._cyclic[3:, :3] = self._cyclic[:2, :3]
        self._cyclic[:, 3:] = self._cyclic[:, :2]
        a, d, b, c = self._factors
        np.multiply(a, d, out=self.values)
        np.multiply(b, c, out=self._minor)
        self.values -= self._minor
        first = np.multiply(self.matrix[0], self.values[0], out=self._minor[0])
        determinant = first[0] + first[1]
        determinant += first[2]
        return np.asarray(determinant)


def polar_rotation(gradient: Matrices, steps: int = 4) -> Matrices:
    """The rotation R of F = R U; where F is inverted, the exponential of its skew part.

    Args:
        gradient: F.
        steps: Of Newton's iteration, with the determinant as its scale. Three are exact to a thousandth for stretches
            up to two; two for a mean of rotations.

    Source: Higham, SIAM J. Sci. Stat. Comput. 7 (1986), 3.2.
    """
    newton = Cofactors(gradient)
    matrix, cofactors = newton.matrix, newton.values
    determinant = newton.update()
    bad = determinant < _MIN_DETERMINANT
    if bad.any():
        matrix[:, :, bad] = exponential(spin_axis(matrix[:, :, bad]))
        determinant = newton.update()
    for step in range(steps):
        if step:
            determinant = newton.update()
        # half of s F + s² cof F, s the inverse of the determinant's cube root
        scale = np.cbrt(determinant)
        np.divide(np.float32(0.5), scale, out=scale)
        matrix *= scale
        scale *= scale
        scale *= np.float32(2.0)
        cofactors *= scale
        matrix += cofactors
    return matrix


def spin_axis(gradient: Matrices) -> Float32[np.ndarray, "3 *rest"]:
    """Axis ω of the infinitesimal rotation, half the curl."""
    return 0.5 * np.stack(
        [gradient[2, 1] - gradient[1, 2], gradient[0, 2] - gradient[2, 0], gradient[1, 0] - gradient[0, 1]]
    )


def exponential(skew: Float32[np.ndarray, "3 *rest"]) -> Matrices:
    """Rotation by the angle |ω| about ω.

    Source: Rodrigues; exp(ω) = cos θ I + sin θ/θ [ω]× + (1 − cos θ)/θ² ω ωᵀ.
    """
    squared = (skew * skew).sum(axis=0)
    angle = np.sqrt(squared)
    sine = np.sinc(angle / np.float32(np.pi))
    half = np.sinc(angle / np.float32(2.0 * np.pi))
    result = (0.5 * half * half) * skew[:, None] * skew[None]
    cosine = np.cos(angle)
    spin = sine * skew
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        result[i, i] += cosine
        result[k, j] += spin[i]
        result[j, k] -= spin[i]
    return np.asarray(result, np.float32)
