"""How far the voxels of a body have moved under a load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32

from service.core.arrays import GRID_SIZE, Eights, Occupancy
from service.core.columns import fill_column, fill_slab, scratch
from service.core.compiled import compiled
from service.core.displacement import Field
from service.core.spread import Spread, in_turn


@dataclass(frozen=True, eq=False)
class Motion:
    """How a body's voxels have moved.

    Attributes:
        moved_m: Displacement, along the axes of the grid, of the material now at each voxel of the deformed body;
            the voxels in C order.
        max_m, mean_m: Lengths over the deformed body; 0 where it is empty.
    """

    moved_m: Float32[np.ndarray, "axis=3 n"]
    max_m: float
    mean_m: float


def motion(field: Field, rest: Occupancy, deformed: Occupancy, edge_m: float, spread: Spread = in_turn) -> Motion:
    """The field at the voxels of the deformed body.

    Between its nodes it is trilinear, and beyond the outermost the last value holds. The lowest voxels of the body at
    rest do not move: they lie half a voxel above what is clamped.

    Args:
        field: Backward displacement in edges of the grid.
        rest: The body before the load.
        deformed: The body after it.
        edge_m: Edge of the grid in metres.
        spread: Over the voxels along x.
    """
    field, deformed = np.ascontiguousarray(field), np.ascontiguousarray(deformed)
    moved_m = np.empty((3, np.count_nonzero(deformed)), np.float32)
    if moved_m.size == 0:
        return Motion(moved_m, 0.0, 0.0)
    sole, eights, edge = np.ascontiguousarray(rest[:, :, 0]), deformed.view(np.uint64), np.float32(edge_m)

    def gather(first: int, end: int) -> None:
        before = int(np.count_nonzero(deformed[:first]))
        _gather(field, sole, deformed, eights, edge, first, end, before, moved_m)

    spread(gather, GRID_SIZE)
    x, y, z = moved_m
    lengths_m = np.sqrt(x * x + y * y + z * z)
    return Motion(moved_m, float(lengths_m.max()), float(lengths_m.mean()))


@compiled
def _gather(
    field: Field, sole: Bool[np.ndarray, "x=64 y=64"], deformed: Occupancy, eights: Eights, edge_m: np.float32,
    first_x: int, end_x: int, n: int, moved_m: Float32[np.ndarray, "axis=3 n"],
) -> None:  # fmt: skip
    """`motion`: metres at every filled voxel of some layers, the first of which is number n of the body."""
    coarse, slab, u = scratch()
    for x in range(first_x, end_x):
        first, end = GRID_SIZE, 0
        for y in range(GRID_SIZE):
            if _any(eights, x, y):
                first, end = min(first, y), y + 1
        if end == 0:
            continue
        fill_slab(field, x, first, end, GRID_SIZE, coarse, slab)
        for y in range(first, end):
            if not _any(eights, x, y):
                continue
            fill_column(slab, sole[x, y], y, GRID_SIZE, u)
            for z in range(GRID_SIZE):
                if deformed[x, y, z]:
                    moved_m[0, n], moved_m[1, n], moved_m[2, n] = edge_m * u[0, z], edge_m * u[1, z], edge_m * u[2, z]
                    n += 1


@compiled
def _any(eights: Eights, x: int, y: int) -> bool:
    """Whether a column holds a filled voxel."""
    found = np.uint64(0)
    for eight in range(GRID_SIZE // 8):
        found |= eights[x, y, eight]
    return bool(found != 0)
