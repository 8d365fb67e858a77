"""Rotations of the cells of a coarse solve: exponential, polar decomposition.

Compiled loops over cells; matrices are laid out components first, (3, 3, k), so that eight cells are treated at once.
"""

from __future__ import annotations

from functools import partial
from typing import TypeAlias

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled

Real: TypeAlias = np.float32
Nine: TypeAlias = tuple[Real, Real, Real, Real, Real, Real, Real, Real, Real]
Matrices = Float32[np.ndarray, "3 3 k"]
Vectors = Float32[np.ndarray, "3 k"]

_MIN_DETERMINANT = np.float32(1e-3)
"""A cell squeezed to less than this, or turned inside out, has no rotation of its own."""

_NEWTON_STEPS = 3
"""Exact to a thousandth for stretches up to two."""

_HALF, _THIRD = np.float32(0.5), np.float32(1.0 / 3.0)


@compiled
def polar_rotations(matrices: Matrices) -> None:
    """Replace every F by the rotation R of F = R U; where F is inverted, by the exponential of its skew part.

    Newton's iteration with the determinant's cube root as its scale. Source: Higham, SIAM J. Sci. Stat. Comput. 7
    (1986), 3.2.
    """
    _replace_inverted(matrices)
    for k in range(matrices.shape[2]):
        a, b, c = matrices[0, 0, k], matrices[0, 1, k], matrices[0, 2, k]
        d, e, f = matrices[1, 0, k], matrices[1, 1, k], matrices[1, 2, k]
        g, h, i = matrices[2, 0, k], matrices[2, 1, k], matrices[2, 2, k]
        for _ in range(_NEWTON_STEPS):
            ca, cb, cc, cd, ce, cf, cg, ch, ci = cofactors(a, b, c, d, e, f, g, h, i)
            scale = inverse_cube_root(a * ca + b * cb + c * cc)
            s, t = _HALF * scale, _HALF * scale * scale
            a, b, c = s * a + t * ca, s * b + t * cb, s * c + t * cc
            d, e, f = s * d + t * cd, s * e + t * ce, s * f + t * cf
            g, h, i = s * g + t * cg, s * h + t * ch, s * i + t * ci
        matrices[0, 0, k], matrices[0, 1, k], matrices[0, 2, k] = a, b, c
        matrices[1, 0, k], matrices[1, 1, k], matrices[1, 2, k] = d, e, f
        matrices[2, 0, k], matrices[2, 1, k], matrices[2, 2, k] = g, h, i


@compiled
def _replace_inverted(matrices: Matrices) -> None:
    for k in range(matrices.shape[2]):
        a, b, c = matrices[0, 0, k], matrices[0, 1, k], matrices[0, 2, k]
        d, e, f = matrices[1, 0, k], matrices[1, 1, k], matrices[1, 2, k]
        g, h, i = matrices[2, 0, k], matrices[2, 1, k], matrices[2, 2, k]
        if a * (e * i - f * h) + b * (f * g - d * i) + c * (d * h - e * g) < _MIN_DETERMINANT:
            a, b, c, d, e, f, g, h, i = exponential(_HALF * (h - f), _HALF * (c - g), _HALF * (d - b))
            matrices[0, 0, k], matrices[0, 1, k], matrices[0, 2, k] = a, b, c
            matrices[1, 0, k], matrices[1, 1, k], matrices[1, 2, k] = d, e, f
            matrices[2, 0, k], matrices[2, 1, k], matrices[2, 2, k] = g, h, i


@compiled
def cofactors(a: Real, b: Real, c: Real, d: Real, e: Real, f: Real, g: Real, h: Real, i: Real) -> Nine:
    """Cofactors (the transposed adjugate) of a matrix given row by row; its inverse is their transpose by det."""
    return (
        e * i - f * h, f * g - d * i, d * h - e * g,
        h * c - i * b, i * a - g * c, g * b - h * a,
        b * f - c * e, c * d - a * f, a * e - b * d,
    )  # fmt: skip


@compiled
def inverse_cube_root(x: Real) -> Real:
    """x^(−1/3) of a positive float32, exact to rounding: Newton's method from a third of the exponent's bits."""
    root = np.int32(0x54A2FA8C - np.float32(x).view(np.int32) // np.int32(3)).view(np.float32)
    for _ in range(3):
        root *= np.float32(4.0) * _THIRD - _THIRD * x * root * root * root
    return root


@compiled
def exponential(x: Real, y: Real, z: Real) -> Nine:
    """Rotation by the angle |ω| about ω = (x, y, z), row by row.

    Source: Rodrigues; exp(ω) = cos θ I + sin θ/θ [ω]× + (1 − cos θ)/θ² ω ωᵀ.
    """
    angle = np.sqrt(x * x + y * y + z * z)
    cosine, sine, versine = np.cos(angle), np.float32(1.0), _HALF
    if angle > 1e-4:
        sine = np.sin(angle) / angle
        half = np.sin(_HALF * angle) / (_HALF * angle)
        versine = _HALF * half * half
    return (
        versine * x * x + cosine, versine * x * y - sine * z, versine * x * z + sine * y,
        versine * y * x + sine * z, versine * y * y + cosine, versine * y * z - sine * x,
        versine * z * x - sine * y, versine * z * y + sine * x, versine * z * z + cosine,
    )  # fmt: skip


@compiled
def exponentials(axes: Vectors, share: Real, result: Matrices) -> None:
    """`exponential` of a share of every axis."""
    for k in range(axes.shape[1]):
        a, b, c, d, e, f, g, h, i = exponential(share * axes[0, k], share * axes[1, k], share * axes[2, k])
        result[0, 0, k], result[0, 1, k], result[0, 2, k] = a, b, c
        result[1, 0, k], result[1, 1, k], result[1, 2, k] = d, e, f
        result[2, 0, k], result[2, 1, k], result[2, 2, k] = g, h, i


@partial(compiled, apart=True)
def spin_axes(gradients: Matrices, result: Vectors) -> None:
    """Axes ω of the infinitesimal rotations, half the curl."""
    for i in range(3):
        more, less, row = gradients[(i + 2) % 3, (i + 1) % 3], gradients[(i + 1) % 3, (i + 2) % 3], result[i]
        for k in range(len(row)):
            row[k] = _HALF * (more[k] - less[k])


@compiled
def add_identity(matrices: Matrices) -> None:
    """From displacement gradients to deformation gradients."""
    for i in range(len(matrices)):
        row = matrices[i, i]
        for k in range(len(row)):
            row[k] += np.float32(1.0)


@partial(compiled, apart=True)
def turn(rotations: Matrices, vectors: Vectors, result: Vectors) -> None:
    """R v of every rotation and vector."""
    x, y, z = vectors[0], vectors[1], vectors[2]
    for i in range(len(result)):
        a, b, c, row = rotations[i, 0], rotations[i, 1], rotations[i, 2], result[i]
        for k in range(len(row)):
            row[k] = a[k] * x[k] + b[k] * y[k] + c[k] * z[k]


@partial(compiled, apart=True)
def turn_back(rotations: Matrices, vectors: Vectors, result: Vectors) -> None:
    """Rᵀ v of every rotation and vector."""
    x, y, z = vectors[0], vectors[1], vectors[2]
    for i in range(len(result)):
        a, b, c, row = rotations[0, i], rotations[1, i], rotations[2, i], result[i]
        for k in range(len(row)):
            row[k] = a[k] * x[k] + b[k] * y[k] + c[k] * z[k]
