"""Pushes on a voxelised body: dead tractions over smooth patches of its surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.condition import Condition
from service.core.prior_grid import CellGrid

MIN_RADIUS = 1.5 / GRID_SIZE
"""Smaller patches would fall between the voxels."""

_FACING = 1.4 / GRID_SIZE
"""The normal at the contact is a mean over about this far."""

_NEAR = 4.0 * _FACING
"""What lies farther counts for less than a thousandth of that mean."""


@dataclass(frozen=True, eq=False)
class Surface:
    """The surface of a body as its voxels show it.

    Attributes:
        occupancy: The body.
        points: Places on the surface, one for every voxel there.
        outward: The gradient of the occupancy at them: a normal as long as the surface is large that each stands for.
    """

    occupancy: Occupancy
    points: Float32[np.ndarray, "3 k"]
    outward: Float32[np.ndarray, "3 k"]

    @classmethod
    def of(cls, grid: CellGrid, occupancy: Occupancy) -> Surface:
        """The surface without the sole, whose voxels go on below: nothing pushes a sole from there."""
        low, high = grid.voxel_bounds
        box = np.zeros(high - low + 2, np.int8)
        box[1:-1, 1:-1, 1:-1] = occupancy[tuple(slice(a, b) for a, b in zip(low, high, strict=True))]
        standing = box.copy()
        standing[:, :, 0] = box[:, :, 1]
        # neighbours lie a stride before and behind: along one line the inner loops are long, and the rim is empty
        line = standing.ravel()
        first, last = box.strides[0], len(line) - box.strides[0]
        outward = np.stack([line[first - s : last - s] - line[first + s : last + s] for s in box.strides])
        exposed = (outward[0] | outward[1] | outward[2]) & -box.ravel()[first:last]
        place = np.flatnonzero(exposed != 0)
        index = np.stack(np.unravel_index(place + first, box.shape)).astype(np.float32)
        normal = outward[:, place].astype(np.float32)
        points = index + (low[:, None] - 0.5).astype(np.float32) + np.float32(0.5) * normal / _length(normal)
        return cls(occupancy, points * np.float32(1.0 / GRID_SIZE), normal)

    def nearest_voxel(self, place: Float64[np.ndarray, "3"]) -> Float32[np.ndarray, "3"]:
        """Centre of the voxel nearest to a place."""
        centres = ((np.argwhere(self.occupancy) + 0.5) / GRID_SIZE).astype(np.float32)
        return np.asarray(centres[np.argmin(((centres - place) ** 2).sum(axis=1))])


def nodal_forces(grid: CellGrid, surface: Surface, conditions: Sequence[Condition]) -> Float32[np.ndarray, "3 loads n"]:
    """Work-equivalent nodal forces of loads; those of each sum to Λ times its direction.

    The traction is weighted (1 − r²/R²)² over the surface within R of the contact, as seen along the normal there: the
    voxels of an edge belong to two faces, of which only one is pushed. Where no surface is near, the nearest voxel is
    pushed.

    Args:
        grid: Cells of the body.
        surface: Of the body.
        conditions: See `service.core.condition`.
    """
    table = np.stack(conditions).astype(np.float64)
    weights = _patches(surface, table[:, :3], np.maximum(table[:, 8], MIN_RADIUS))
    pushed = np.flatnonzero(weights.any(axis=0))
    share = weights[:, pushed] @ grid.interpolation(surface.points[:, pushed])
    for missed in np.flatnonzero(~weights.any(axis=1)):
        share[missed] = grid.interpolation(surface.nearest_voxel(table[missed, :3])[:, None])[0]
    force = 10.0 ** table[:, 6:7] * table[:, 3:6]
    return np.asarray(force.T[:, :, None] * (share / share.sum(axis=1, keepdims=True)), np.float32)


def _patches(
    surface: Surface, contacts: Float64[np.ndarray, "loads 3"], radii: Float64[np.ndarray, " loads"]
) -> Float32[np.ndarray, "loads k"]:
    """Weight of every point of the surface in every load."""
    loads, k = len(contacts), surface.points.shape[1]
    reach = np.maximum(radii, _NEAR).astype(np.float32)[:, None]
    distance = np.zeros((loads, k), np.float32)
    for axis in range(3):
        offset = surface.points[axis] - contacts[:, axis, None].astype(np.float32)
        offset *= offset
        distance += offset
    place = np.flatnonzero(distance < reach * reach)
    load, near = np.divmod(place, k)
    squared, outward = distance.ravel()[place], surface.outward[:, near]
    mean = outward * (np.exp(squared * np.float32(-0.5 / _FACING**2)) * _length(outward))
    normal = np.stack([np.bincount(load, axis, loads) for axis in mean]).astype(np.float32)
    within = np.maximum(1.0 - squared / (radii**2).astype(np.float32)[load], 0.0)
    weights = np.zeros((loads, k), np.float32)
    weights.ravel()[place] = within * within * np.maximum((normal[:, load] * outward).sum(axis=0), 0.0)
    return weights


def _length(vectors: Float32[np.ndarray, "3 k"]) -> Float32[np.ndarray, " k"]:
    return np.asarray(np.sqrt((vectors * vectors).sum(axis=0)))
