"""A push on a voxelised body: a dead traction over a smooth patch of its surface."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from service.core.arrays import GRID_SIZE, Occupancy, Vector3
from service.core.condition import Condition
from service.core.prior_grid import CellGrid

MIN_RADIUS = 1.5 / GRID_SIZE
"""Smaller patches would fall between the voxels."""

_FACING = 1.4 / GRID_SIZE
"""The normal at the contact is a mean over about this far."""


def nodal_force(grid: CellGrid, occupancy: Occupancy, condition: Condition) -> Float64[np.ndarray, "n 3"]:
    """Work-equivalent nodal forces of one load; they sum to Λ times its direction.

    The traction is weighted (1 − r²/R²)² over the surface within R of the contact, as seen along the normal there: the
    voxels of an edge belong to two faces, of which only one is pushed. Surface and normals are the gradient of the
    occupancy; the sole is no surface. Where no surface is near, the nearest voxel is pushed.

    Args:
        grid: Cells of the body.
        occupancy: The body.
        condition: See `service.core.condition`.
    """
    contact = condition[:3].astype(np.float64)
    radius = max(float(condition[8]), MIN_RADIUS)
    points, weights = _patch(occupancy, round(float(grid.low[2]) * GRID_SIZE), contact, radius)
    if len(points) == 0:
        voxels = (np.argwhere(occupancy) + 0.5) / GRID_SIZE
        points, weights = voxels[[np.argmin(((voxels - contact) ** 2).sum(axis=1))]], np.ones(1)
    share = grid.spread(points, weights)
    force = 10.0 ** float(condition[6]) * condition[3:6].astype(np.float64)
    return np.asarray(share[:, None] / share.sum() * force)


def _patch(
    occupancy: Occupancy, floor: int, contact: Vector3, radius: float
) -> tuple[Float64[np.ndarray, "k 3"], Float64[np.ndarray, " k"]]:
    """Places on the surface under a patch, and the traction's weight times the surface that each stands for.

    Args:
        occupancy: The body.
        floor: Index of its lowest layer of voxels, which goes on below: nothing pushes a sole from there.
        contact: Middle of the patch.
        radius: Its radius.
    """
    low = np.clip(np.floor((contact - radius) * GRID_SIZE).astype(int), 0, GRID_SIZE - 1)
    high = np.clip(np.ceil((contact + radius) * GRID_SIZE).astype(int), low + 1, GRID_SIZE)
    outer = [(max(a - 1, 0), min(b + 1, GRID_SIZE)) for a, b in zip(low, high, strict=True)]
    rim = [(int(a == 0), int(b == GRID_SIZE)) for a, b in zip(low, high, strict=True)]
    box = np.pad(occupancy[tuple(slice(*ends) for ends in outer)].astype(np.float32), rim)
    if low[2] <= floor < high[2]:
        box[:, :, floor - low[2]] = box[:, :, floor - low[2] + 1]
    inner = slice(1, -1)
    outward_x = box[:-2, inner, inner] - box[2:, inner, inner]
    outward_y = box[inner, :-2, inner] - box[inner, 2:, inner]
    outward_z = box[inner, inner, :-2] - box[inner, inner, 2:]
    squared_area = outward_x**2 + outward_y**2 + outward_z**2
    inside = np.flatnonzero(squared_area * box[inner, inner, inner])
    gradient = np.stack([axis.ravel()[inside] for axis in (outward_x, outward_y, outward_z)])
    area = np.sqrt(squared_area.ravel()[inside])
    place = np.stack(np.unravel_index(inside, high - low)) + low[:, None]
    points = ((place + 0.5 + 0.5 * gradient / area) / GRID_SIZE).T
    squared = ((points - contact) ** 2).sum(axis=1)
    outward = gradient @ (area * np.exp(-squared / (2.0 * _FACING**2)))
    weight = np.clip(1.0 - squared / radius**2, 0.0, None) ** 2 * np.clip(outward @ gradient, 0.0, None)
    pushed = weight > 0.0
    return points[pushed], weight[pushed].astype(np.float64)
