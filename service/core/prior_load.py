"""Pushes on a voxelised body: dead tractions over smooth patches of its surface."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.compiled import compiled
from service.core.condition import Condition
from service.core.prior_grid import CellGrid, column_words

MIN_RADIUS = 1.5 / GRID_SIZE
"""Smaller patches would fall between the voxels."""

_FACING = np.float32(1.4 / GRID_SIZE)
"""The normal at the contact is a mean over about this far."""

_NEAR = np.float32(4.0) * _FACING
"""What lies farther counts for less than a thousandth of that mean."""


Points = Float32[np.ndarray, "3 k"]


@dataclass(frozen=True, eq=False)
class Surface:
    """The surface of a body as its voxels show it.

    Attributes:
        occupancy: The body.
        points: Places on the surface, one for every voxel there.
        outward: The gradient of the occupancy at them: a normal as long as the surface is large that each stands for.
    """

    occupancy: Occupancy
    points: Points
    outward: Points

    @classmethod
    def of(cls, grid: CellGrid, occupancy: Occupancy) -> Surface:
        """The surface without the sole, whose voxels go on below: nothing pushes a sole from there."""
        floor = int(grid.voxel_bounds[0][2])
        words = column_words(occupancy)
        around = np.pad(words, 1)
        along_x, along_y = around[:-2, 1:-1] ^ around[2:, 1:-1], around[1:-1, :-2] ^ around[1:-1, 2:]
        below = words << np.uint64(1) | words & np.uint64(1 << floor)
        exposed = words & (along_x | along_y | (below ^ words >> np.uint64(1)))
        place = np.flatnonzero(np.unpackbits(exposed.view(np.uint8), bitorder="little").view(bool))
        index = np.stack(np.unravel_index(place, occupancy.shape))
        solid = np.pad(occupancy.view(np.int8), 1)
        solid[:, :, floor] = solid[:, :, floor + 1]
        # neighbours lie a stride before and behind
        line, strides = solid.ravel(), np.array(solid.strides)
        at = strides @ (index + 1)
        outward = np.stack([line[at - stride] - line[at + stride] for stride in strides]).astype(np.float32)
        length = np.sqrt((outward * outward).sum(axis=0))
        points = (index.astype(np.float32) + np.float32(0.5) + outward / (length + length)) / np.float32(GRID_SIZE)
        return cls(occupancy, points, outward)

    def nearest_voxel(self, place: Float64[np.ndarray, "3"]) -> Float32[np.ndarray, "3 1"]:
        """Centre of the voxel nearest to a place."""
        centres = ((np.argwhere(self.occupancy) + 0.5) / GRID_SIZE).astype(np.float32)
        return np.asarray(centres[np.argmin(((centres - place) ** 2).sum(axis=1))][:, None])


def nodal_forces(grid: CellGrid, surface: Surface, conditions: Sequence[Condition]) -> Float32[np.ndarray, "loads 3 n"]:
    """Work-equivalent nodal forces of loads; those of each sum to Λ times its direction.

    The traction is weighted (1 − r²/R²)² over the surface within R of the contact, as seen along the normal there: the
    voxels of an edge belong to two faces, of which only one is pushed. Where no surface is near, the nearest voxel is
    pushed.

    Args:
        grid: Cells of the body.
        surface: Of the body.
        conditions: See `service.core.condition`.
    """
    weights = np.empty(surface.points.shape[1], np.float32)
    result = np.empty((len(conditions), 3, len(grid.nodes)), np.float32)
    for condition, force in zip(conditions, result, strict=True):
        contact, direction, load = condition[:3], condition[3:6], 10.0 ** np.float64(condition[6])
        pushed = _patch(surface.points, surface.outward, contact, np.float32(max(condition[8], MIN_RADIUS)), weights)
        if pushed:
            share = grid.at_nodes(surface.points, weights)
        else:
            share = grid.at_nodes(surface.nearest_voxel(contact.astype(np.float64)), np.ones(1, np.float32))
        force[...] = (load * direction.astype(np.float64))[:, None] * (share / share.sum())
    return result


@compiled
def _patch(
    points: Points, outward: Points, contact: Float32[np.ndarray, "3"], radius: np.float32,
    weights: Float32[np.ndarray, " k"],
) -> bool:  # fmt: skip
    """Write the weight of every point of the surface in a load; False where all are zero."""
    reach = max(radius, _NEAR)
    x, y, z = points[0], points[1], points[2]
    normal_x, normal_y, normal_z = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    for k in range(len(weights)):  # squared distances first
        weights[k] = (x[k] - contact[0]) ** 2 + (y[k] - contact[1]) ** 2 + (z[k] - contact[2]) ** 2
    for k in range(len(weights)):
        if weights[k] < reach * reach:
            a, b, c = outward[0, k], outward[1, k], outward[2, k]
            share = np.exp(weights[k] * (np.float32(-0.5) / (_FACING * _FACING))) * np.sqrt(a * a + b * b + c * c)
            normal_x, normal_y, normal_z = normal_x + share * a, normal_y + share * b, normal_z + share * c
    pushed = False
    for k in range(len(weights)):
        if weights[k] < radius * radius:
            within = np.float32(1.0) - weights[k] / (radius * radius)
            facing = normal_x * outward[0, k] + normal_y * outward[1, k] + normal_z * outward[2, k]
            weights[k] = within * within * max(facing, np.float32(0.0))
            pushed = pushed or weights[k] > 0.0
        else:
            weights[k] = 0.0
    return pushed
