"""Pushes on a voxelised body: dead tractions over smooth patches of its surface."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Float32

from service.core.arrays import GRID_SIZE, Bytes, Occupancy
from service.core.compiled import compiled
from service.core.condition import Condition
from service.core.prior_grid import CellGrid

MIN_RADIUS = 1.5 / GRID_SIZE
"""Smaller patches would fall between the voxels."""

_FACING = np.float32(1.4 / GRID_SIZE)
"""The normal at the contact is a mean over about this far."""

_NEAR = np.float32(4.0) * _FACING
"""What lies farther counts for less than a thousandth of that mean."""

_ZERO, _HALF, _ONE, _TWO = np.float32(0.0), np.float32(0.5), np.float32(1.0), np.float32(2.0)
_SIZE = np.float32(GRID_SIZE)

Points = Float32[np.ndarray, "3 k"]
Vector: TypeAlias = tuple[np.float32, np.float32, np.float32]


def nodal_forces(
    grid: CellGrid, occupancy: Occupancy, conditions: Sequence[Condition]
) -> Float32[np.ndarray, "loads 3 n"]:
    """Work-equivalent nodal forces of loads; those of each sum to Λ times its direction.

    The traction is weighted (1 − r²/R²)² over the surface within R of the contact, as seen along the normal there: the
    voxels of an edge belong to two faces, of which only one is pushed. Where no surface is near, the nearest voxel is
    pushed.

    Args:
        grid: Cells of the body.
        occupancy: The body.
        conditions: See `service.core.condition`.
    """
    voxels = np.ascontiguousarray(occupancy).view(np.uint8)
    result = np.empty((len(conditions), 3, len(grid.nodes)), np.float32)
    for condition, force in zip(conditions, result, strict=True):
        contact, direction, load = condition[:3], condition[3:6], 10.0 ** np.float64(condition[6])
        radius = np.float32(max(condition[8], MIN_RADIUS))
        points, weights = _patch(voxels, grid.floor, np.ascontiguousarray(contact), radius)
        if not weights.any():
            points, weights = _nearest_voxel(occupancy, contact), np.ones(1, np.float32)
        share = grid.at_nodes(points, weights)
        force[...] = (load * direction.astype(np.float64))[:, None] * (share / share.sum())
    return result


def _nearest_voxel(occupancy: Occupancy, place: Float32[np.ndarray, "3"]) -> Points:
    """Centre of the voxel nearest to a place."""
    centres = ((np.argwhere(occupancy) + 0.5) / GRID_SIZE).astype(np.float32)
    return np.asarray(centres[np.argmin(((centres - place) ** 2).sum(axis=1))][:, None])


@compiled
def _patch(
    occupancy: Bytes, floor: int, contact: Float32[np.ndarray, "3"], radius: np.float32
) -> tuple[Points, Float32[np.ndarray, " k"]]:
    """Places on the surface near a contact, one for every voxel there, and the weight of each in a load.

    Args:
        occupancy: The body.
        floor: Its lowest layer, whose voxels go on below: nothing pushes a sole from there.
        contact: In edges of the grid.
        radius: Of the patch.
    """
    reach = max(radius, _NEAR)
    first, end = np.empty(3, np.int64), np.empty(3, np.int64)
    for axis in range(3):  # a place is at most half a voxel off the centre of its voxel
        first[axis] = int(min(max((contact[axis] - reach) * _SIZE - _ONE, _ZERO), _SIZE))
        end[axis] = int(min(max((contact[axis] + reach) * _SIZE + _TWO, _ZERO), _SIZE))
    normal_x, normal_y, normal_z, count = _ZERO, _ZERO, _ZERO, 0
    points, weights = np.empty((3, 0), np.float32), np.empty(0, np.float32)
    for normal_known in (False, True):
        if normal_known:
            points, weights, count = np.empty((3, count), np.float32), np.empty(count, np.float32), 0
        for i in range(first[0], end[0]):
            for j in range(first[1], end[1]):
                for k in range(first[2], end[2]):
                    if not occupancy[i, j, k]:
                        continue
                    a, b, c = _outward(occupancy, floor, i, j, k)
                    x, y, z = _place(i, j, k, a, b, c)
                    squared = (x - contact[0]) ** 2 + (y - contact[1]) ** 2 + (z - contact[2]) ** 2
                    if not squared < reach * reach:  # nor inside the body, where it is no number
                        continue
                    if not normal_known:
                        share = np.exp(squared * (_HALF / (-_FACING * _FACING))) * np.sqrt(a * a + b * b + c * c)
                        normal_x, normal_y, normal_z = normal_x + share * a, normal_y + share * b, normal_z + share * c
                    if squared < radius * radius:
                        if normal_known:
                            within = _ONE - squared / (radius * radius)
                            facing = normal_x * a + normal_y * b + normal_z * c
                            points[0, count], points[1, count], points[2, count] = x, y, z
                            weights[count] = within * within * max(facing, _ZERO)
                        count += 1
    return points, weights


@compiled
def _outward(occupancy: Bytes, floor: int, i: int, j: int, k: int) -> Vector:
    """The gradient of the occupancy at a voxel: a normal as long as the surface is large that it stands for."""
    last = GRID_SIZE - 1
    a = (occupancy[i - 1, j, k] if i > 0 else 0) - (occupancy[i + 1, j, k] if i < last else 0)
    b = (occupancy[i, j - 1, k] if j > 0 else 0) - (occupancy[i, j + 1, k] if j < last else 0)
    c = (occupancy[i, j, k - 1] if k > floor else 1) - (occupancy[i, j, k + 1] if k < last else 0)
    return np.float32(a), np.float32(b), np.float32(c)


@compiled
def _place(i: int, j: int, k: int, a: np.float32, b: np.float32, c: np.float32) -> Vector:
    """Of the surface at a voxel, in edges of the grid: half a voxel outward from its centre. No number inside."""
    half = _HALF / np.sqrt(a * a + b * b + c * c)
    x, y, z = np.float32(i) + _HALF + half * a, np.float32(j) + _HALF + half * b, np.float32(k) + _HALF + half * c
    return x / _SIZE, y / _SIZE, z / _SIZE
