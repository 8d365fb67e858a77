"""Rotations of the cells of a coarse solve: exponential, polar decomposition.

All arrays are laid out components first, (3, 3, …), so that one operation serves all cells and loads.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

_CYCLIC = np.array([[1, 2], [2, 0], [0, 1]])
_PLUS_A = np.array([3 * _CYCLIC[i, 0] + _CYCLIC[j, 0] for i in range(3) for j in range(3)])
_PLUS_B = np.array([3 * _CYCLIC[i, 1] + _CYCLIC[j, 1] for i in range(3) for j in range(3)])
_MINUS_A = np.array([3 * _CYCLIC[i, 0] + _CYCLIC[j, 1] for i in range(3) for j in range(3)])
_MINUS_B = np.array([3 * _CYCLIC[i, 1] + _CYCLIC[j, 0] for i in range(3) for j in range(3)])

_POLAR_STEPS = 4
_MIN_DETERMINANT = 1e-3
"""A cell squeezed to less than this, or turned inside out, has no rotation of its own."""


def cofactor(
    matrices: Float32[np.ndarray, "9 k"],
) -> tuple[Float32[np.ndarray, "9 k"], Float32[np.ndarray, " k"]]:
    """Cofactors (the transposed adjugate) and determinants of matrices stored row by row."""
    result = matrices[_PLUS_A] * matrices[_PLUS_B]
    result -= matrices[_MINUS_A] * matrices[_MINUS_B]
    determinant = np.asarray((matrices[:3] * result[:3]).sum(axis=0))
    return result, determinant


def polar_rotation(gradient: Float32[np.ndarray, "3 3 *rest"]) -> Float32[np.ndarray, "3 3 *rest"]:
    """The rotation R of F = R U; where F is inverted, the exponential of its skew part.

    Newton's iteration with the determinant as its scale. Source: Higham, SIAM J. Sci. Stat. Comput. 7 (1986), 3.2.
    """
    matrix = gradient.reshape(9, -1)
    cofactors, determinant = cofactor(matrix)
    bad = determinant < _MIN_DETERMINANT
    if bad.any():
        matrix = matrix.copy()
        matrix[:, bad] = exponential(spin_axis(matrix[:, bad].reshape(3, 3, -1))).reshape(9, -1)
        cofactors, determinant = cofactor(matrix)
    for step in range(_POLAR_STEPS):
        if step:
            cofactors, determinant = cofactor(matrix)
        scale = np.cbrt(1.0 / determinant)
        matrix = 0.5 * (scale * matrix + cofactors * (scale * scale))
    return matrix.reshape(gradient.shape)


def spin_axis(gradient: Float32[np.ndarray, "3 3 *rest"]) -> Float32[np.ndarray, "3 *rest"]:
    """Axis ω of the infinitesimal rotation, half the curl."""
    return 0.5 * np.stack(
        [gradient[2, 1] - gradient[1, 2], gradient[0, 2] - gradient[2, 0], gradient[1, 0] - gradient[0, 1]]
    )


def exponential(skew: Float32[np.ndarray, "3 *rest"]) -> Float32[np.ndarray, "3 3 *rest"]:
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
