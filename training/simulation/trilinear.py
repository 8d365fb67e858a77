"""The trilinear functions of a cell as polynomials, for compiled loops."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from jaxtyping import Float64, Int

from service.core.compiled import compiled

Eight: TypeAlias = tuple[float, float, float, float, float, float, float, float]


@compiled
def coefficients(
    a: float, b: float, c: float, d: float, e: float, f: float, g: float, h: float
) -> Eight:
    """Coefficients of 1, ξ, η, ζ, ξη, ηζ, ζξ, ξηζ from the values at the corners, ξ, η, ζ = ±½.

    The corners are those of `elements.CORNERS`, number 4·dx + 2·dy + dz.
    """
    # sums and differences along ζ, then η, then ξ
    a, b, c, d, e, f, g, h = a + b, b - a, c + d, d - c, e + f, f - e, g + h, h - g
    a, b, c, d, e, f, g, h = a + c, b + d, c - a, d - b, e + g, f + h, g - e, h - f
    return (
        0.125 * (a + e), 0.25 * (e - a), 0.25 * (c + g), 0.25 * (b + f),
        0.5 * (g - c), 0.5 * (d + h), 0.5 * (f - b), h - d,
    )  # fmt: skip


@compiled
def nodal_coefficients(
    nodal: Float64[np.ndarray, "nodes 3"], cell_nodes: Int[np.ndarray, "m 8"], cell: int, axis: int
) -> Eight:
    """As `coefficients`, of a nodal field in a cell along an axis."""
    return coefficients(
        nodal[cell_nodes[cell, 0], axis], nodal[cell_nodes[cell, 1], axis],
        nodal[cell_nodes[cell, 2], axis], nodal[cell_nodes[cell, 3], axis],
        nodal[cell_nodes[cell, 4], axis], nodal[cell_nodes[cell, 5], axis],
        nodal[cell_nodes[cell, 6], axis], nodal[cell_nodes[cell, 7], axis],
    )  # fmt: skip


@compiled
def value_at(terms: Eight, x: float, y: float, z: float) -> float:
    """The polynomial of these coefficients at ξ, η, ζ."""
    value = terms[0] + x * terms[1] + y * terms[2] + z * terms[3]
    return value + x * y * terms[4] + y * z * terms[5] + z * x * terms[6] + x * y * z * terms[7]


@compiled
def corner_sums(
    one: float, x: float, y: float, z: float, xy: float, yz: float, zx: float, xyz: float
) -> Eight:
    """The transpose of `coefficients`: what a functional of the coefficients is of the values at the corners."""
    one, x, y, z, xy, yz, zx = 0.125 * one, 0.25 * x, 0.25 * y, 0.25 * z, 0.5 * xy, 0.5 * yz, 0.5 * zx
    # undo ξ: what stands with the sum and with the difference of the two halves
    a, b, c, d = one - x, z - zx, y - xy, yz - xyz
    e, f, g, h = one + x, z + zx, y + xy, yz + xyz
    # undo η
    a, b, c, d = a - c, b - d, a + c, b + d
    e, f, g, h = e - g, f - h, e + g, f + h
    # undo ζ
    return a - b, a + b, c - d, c + d, e - f, e + f, g - h, g + h
