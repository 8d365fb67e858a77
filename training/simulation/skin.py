"""The whole surface of a body as points to integrate over, found once for all of its loads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int, Int32

from service.core.compiled import compiled
from training.simulation.sampled import SampledDistance, interpolated
from training.simulation.surface import SHELL, shell_area, tetrahedral_gradient

LATTICE = 4
"""Points of the lattice along each edge of a cell, two of them in an octant."""
_VAGUE = 0.15
"""Doubt, in spacings of the sampled lattice, beyond which an octant is taken to hold an edge."""


@dataclass(frozen=True, eq=False)
class Skin:
    """Points on the surface of a shape in the unit cube, from all points of a cubic lattice in a thin shell around it.

    The lattice has four points along the edge of a cell. Each that lies within 1.5 spacings of the surface is projected
    onto it along the gradient there.

    Attributes:
        points: On the surface, in units of L.
        normals: Outward there.
        area: That each stands for, in units of L²; see `shell_area`.
    """

    points: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]
    area: Float64[np.ndarray, " n"]

    @classmethod
    def of(cls, sampled: SampledDistance) -> Skin:
        """Interpolate the sampled distance; along edges, where that would round normals, ask the function itself."""
        spacing = 1.0 / (LATTICE * sampled.cells)
        shell = SHELL * spacing
        octants = np.argwhere(sampled.number >= 0)
        number = sampled.number[tuple(octants.T)]
        edge = 2 * sampled.cells
        vague = sampled.doubt[number] > _VAGUE / (LATTICE * sampled.cells)
        place, value, gradient = _near(octants[~vague], number[~vague], edge, sampled.polynomial, shell)
        asked = ((octants[vague][:, None] + _INNER) / edge).reshape(-1, 3)
        asked_value = sampled(asked.astype(np.float32)).astype(np.float64)
        near = np.abs(asked_value) < shell
        place = np.concatenate([place, asked[near]])
        value = np.concatenate([value, asked_value[near]])
        gradient = np.concatenate([gradient, tetrahedral_gradient(sampled, asked[near])])
        squared = np.maximum((gradient**2).sum(axis=1, keepdims=True), 1e-6)
        points = place - gradient * (value[:, None] / squared)
        return cls(points, gradient / np.sqrt(squared), shell_area(value, spacing))


_INNER = (0.5 * np.argwhere(np.ones((2, 2, 2), bool)) + 0.25).astype(np.float64)
"""Points of the lattice within an octant, in its edges."""


def _near(
    octants: Int[np.ndarray, "n 3"],
    number: Int32[np.ndarray, " n"],
    edge: int,
    polynomial: Float32[np.ndarray, "k 27"],
    shell: float,
) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, " m"], Float64[np.ndarray, "m 3"]]:
    """Points of the lattice within the shell, interpolated values and gradients there."""
    most = len(_INNER) * len(octants)
    place, value, gradient = np.empty((most, 3)), np.empty(most), np.empty((most, 3))
    count = _interpolate(octants, number, edge, polynomial, shell, place, value, gradient)
    return place[:count], value[:count], gradient[:count]


@compiled
def _interpolate(
    octants: Int[np.ndarray, "n 3"],
    number: Int32[np.ndarray, " n"],
    edge: int,
    polynomial: Float32[np.ndarray, "k 27"],
    shell: float,
    place: Float64[np.ndarray, "n8 3"],
    value: Float64[np.ndarray, " n8"],
    gradient: Float64[np.ndarray, "n8 3"],
) -> int:
    """Fill the rows of the results; returns how many are filled."""
    row = 0
    for index in range(len(octants)):
        i, j, k = octants[index, 0], octants[index, 1], octants[index, 2]
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    u, v, w = a - 0.5, b - 0.5, c - 0.5
                    distance = interpolated(polynomial, number[index], u, v, w)
                    if not abs(distance) < shell:
                        continue
                    value[row] = distance
                    place[row, 0] = (i + 0.25 + 0.5 * a) / edge
                    place[row, 1] = (j + 0.25 + 0.5 * b) / edge
                    place[row, 2] = (k + 0.25 + 0.5 * c) / edge
                    p, q, r = _gradient(polynomial, number[index], u, v, w)
                    gradient[row, 0], gradient[row, 1], gradient[row, 2] = 2 * edge * p, 2 * edge * q, 2 * edge * r
                    row += 1
    return row


@compiled
def _gradient(
    polynomial: Float32[np.ndarray, "k 27"], row: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Gradient of `interpolated` by the local coordinates."""
    dx, dy, dz = 0.0, 0.0, 0.0
    p, q, r = (1.0, x, x * x), (1.0, y, y * y), (1.0, z, z * z)
    dp, dq, dr = (0.0, 1.0, 2.0 * x), (0.0, 1.0, 2.0 * y), (0.0, 1.0, 2.0 * z)
    for a in range(3):
        for b in range(3):
            for c in range(3):
                value = polynomial[row, 9 * a + 3 * b + c]
                dx += dp[a] * q[b] * r[c] * value
                dy += p[a] * dq[b] * r[c] * value
                dz += p[a] * q[b] * dr[c] * value
    return dx, dy, dz
