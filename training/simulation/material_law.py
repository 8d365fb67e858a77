"""Isotropic hyperelasticity in non-dimensional form: Young's modulus is 1, stresses are in units of it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

MAX_POISSON_RATIO = 0.49
"""Above this the λ part dominates rounding and conditioning; requests of 0.5 are answered at this value."""


def lame(poisson_ratio: float) -> tuple[float, float]:
    """Shear modulus μ and Lamé's first parameter λ for Young's modulus 1.

    Args:
        poisson_ratio: ν in [0, 0.49].

    Raises:
        ValueError: ν is outside its range.

    Source: μ = 1/(2(1+ν)), λ = ν/((1+ν)(1−2ν)); Bonet and Wood (2008), eq. 6.29.
    """
    if not 0.0 <= poisson_ratio <= MAX_POISSON_RATIO:
        raise ValueError(f"Poisson's ratio is {poisson_ratio}; the element is verified for 0 to {MAX_POISSON_RATIO}")
    return 0.5 / (1.0 + poisson_ratio), poisson_ratio / ((1.0 + poisson_ratio) * (1.0 - 2.0 * poisson_ratio))


def cofactor(
    gradient: Float64[np.ndarray, "gauss 9 cells"],
) -> tuple[Float64[np.ndarray, "gauss 9 cells"], Float64[np.ndarray, "gauss cells"]]:
    """Cofactor matrix J F⁻ᵀ and determinant J of deformation gradients stored row by row."""
    f = [gradient[:, component] for component in range(9)]
    result = np.empty_like(gradient)
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            minor = f[3 * i1 + j1] * f[3 * i2 + j2]
            minor -= f[3 * i1 + j2] * f[3 * i2 + j1]
            result[:, 3 * i + j] = minor
    determinant = f[0] * result[:, 0] + f[1] * result[:, 1] + f[2] * result[:, 2]
    return result, determinant
