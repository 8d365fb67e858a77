"""The part of a surface within a ball, as points to integrate over: what carries a load."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64

from service.core.arrays import Vector3
from training.simulation.compiled import compiled
from training.simulation.sampled import SAMPLED_SHELL, STRAIGHT_ERROR, SampledDistance, interpolated, straight
from training.simulation.surface import SHELL, Distance, surface_quadrature

_SLACK = 1e-9
_VAGUE = 0.15
"""Doubt, in spacings of the sampled lattice, beyond which an octant is taken to hold an edge."""


def surface_patch(
    distance: Distance, centre: Vector3, radius: float, spacing: float
) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, "m 3"], Float64[np.ndarray, " m"]]:
    """Points on the surface around a place, outward unit normals and areas; see `surface_quadrature`.

    Args:
        distance: The shape; one that is sampled densely enough is interpolated instead of asked.
        centre: Centre of the ball.
        radius: Of the ball.
        spacing: Of the cubic lattice, one of whose points lies at the ball's low corner.
    """
    reach = np.arange(-radius, radius + spacing, spacing)
    if isinstance(distance, SampledDistance) and SHELL * spacing <= (0.5 * SAMPLED_SHELL + _SLACK) / distance.cells:
        return _interpolated_patch(distance, centre, radius, spacing, reach)
    lattice = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), axis=-1).reshape(-1, 3)
    return surface_quadrature(distance, centre + lattice[(lattice**2).sum(axis=1) < radius**2], spacing)


def _interpolated_patch(
    sampled: SampledDistance, centre: Vector3, radius: float, spacing: float, reach: Float64[np.ndarray, " n"]
) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, "m 3"], Float64[np.ndarray, " m"]]:
    # along edges, where interpolation would round the normals, the function itself is asked
    vague = _VAGUE / (4 * sampled.cells)
    shell = SHELL * spacing
    values, count, doubtful = _lattice_values(centre, reach, radius, shell, vague, sampled.lattice, sampled.doubt)
    points, normals, area = np.empty((count, 3)), np.empty((count, 3)), np.empty(count)
    _project(centre, reach, values, sampled.lattice, shell, points, normals, area)
    if not doubtful:
        return points, normals, area * (spacing**2 / SHELL)
    asked = centre + reach[np.argwhere(np.isnan(values))]
    more_points, more_normals, more_area = surface_quadrature(sampled, asked, spacing)
    return (
        np.concatenate([points, more_points]),
        np.concatenate([normals, more_normals]),
        np.concatenate([area * (spacing**2 / SHELL), more_area]),
    )


@compiled
def _lattice_values(
    centre: Vector3,
    reach: Float64[np.ndarray, " n"],
    radius: float,
    shell: float,
    vague: float,
    lattice: Float32[np.ndarray, "n4 n4 n4"],
    doubt: Float32[np.ndarray, "n2 n2 n2"],
) -> tuple[Float64[np.ndarray, "n n n"], int, int]:
    """Interpolated distances at centre + reach × reach × reach, how many lie within the shell, and how many are NaN.

    Infinite out of the ball and far from the surface, NaN where an octant of more doubt than `vague` may hold a point
    of the shell.
    """
    near, doubtful = 0, 0
    n = doubt.shape[0]
    values = np.full((len(reach), len(reach), len(reach)), np.inf)
    for a in range(len(reach)):
        x = (centre[0] + reach[a]) * n
        for b in range(len(reach)):
            y = (centre[1] + reach[b]) * n
            for c in range(len(reach)):
                z = (centre[2] + reach[c]) * n
                if reach[a] ** 2 + reach[b] ** 2 + reach[c] ** 2 >= radius**2 or min(x, y, z) < 0 or max(x, y, z) >= n:
                    continue
                i, j, k = int(x), int(y), int(z)
                if doubt[i, j, k] <= 0.0:
                    continue
                u, v, w = 2.0 * (x - i) - 1.0, 2.0 * (y - j) - 1.0, 2.0 * (z - k) - 1.0
                # far points need no more than the corners to tell
                if abs(straight(lattice, i, j, k, u, v, w)) > shell + STRAIGHT_ERROR * doubt[i, j, k]:
                    continue
                if doubt[i, j, k] > vague:
                    values[a, b, c] = np.nan
                    doubtful += 1
                    continue
                values[a, b, c] = interpolated(lattice, i, j, k, u, v, w)
                near += abs(values[a, b, c]) < shell
    return values, near, doubtful


@compiled
def _project(
    centre: Vector3,
    reach: Float64[np.ndarray, " n"],
    values: Float64[np.ndarray, "n n n"],
    lattice: Float32[np.ndarray, "n4 n4 n4"],
    shell: float,
    points: Float64[np.ndarray, "m 3"],
    normals: Float64[np.ndarray, "m 3"],
    area: Float64[np.ndarray, " m"],
) -> None:
    """Write the projection onto the surface of every lattice point within the shell, along the gradient there."""
    n = (lattice.shape[0] - 1) // 2
    row = 0
    for a in range(len(reach)):
        for b in range(len(reach)):
            for c in range(len(reach)):
                value = values[a, b, c]
                if not abs(value) < shell:
                    continue
                x, y, z = centre[0] + reach[a], centre[1] + reach[b], centre[2] + reach[c]
                i, j, k = int(x * n), int(y * n), int(z * n)
                u, v, w = 2.0 * (x * n - i) - 1.0, 2.0 * (y * n - j) - 1.0, 2.0 * (z * n - k) - 1.0
                p, q, r = _gradient(lattice, i, j, k, u, v, w)
                squared = max((p * p + q * q + r * r) * (4.0 * n * n), 1e-6)
                step = value / squared * (2.0 * n)
                points[row, 0], points[row, 1], points[row, 2] = x - step * p, y - step * q, z - step * r
                length = max(np.sqrt(p * p + q * q + r * r), 1e-12)
                normals[row, 0], normals[row, 1], normals[row, 2] = p / length, q / length, r / length
                area[row] = 1.0 - abs(value) / shell
                row += 1


@compiled
def _gradient(
    lattice: Float32[np.ndarray, "n4 n4 n4"], i: int, j: int, k: int, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Gradient of `interpolated` by the local coordinates."""
    p = (0.5 * x * (x - 1.0), 1.0 - x * x, 0.5 * x * (x + 1.0))
    q = (0.5 * y * (y - 1.0), 1.0 - y * y, 0.5 * y * (y + 1.0))
    r = (0.5 * z * (z - 1.0), 1.0 - z * z, 0.5 * z * (z + 1.0))
    dp = (x - 0.5, -2.0 * x, x + 0.5)
    dq = (y - 0.5, -2.0 * y, y + 0.5)
    dr = (z - 0.5, -2.0 * z, z + 0.5)
    dx, dy, dz = 0.0, 0.0, 0.0
    for a in range(3):
        for b in range(3):
            for c in range(3):
                value = lattice[2 * i + a, 2 * j + b, 2 * k + c]
                dx += dp[a] * q[b] * r[c] * value
                dy += p[a] * dq[b] * r[c] * value
                dz += p[a] * q[b] * dr[c] * value
    return dx, dy, dz
