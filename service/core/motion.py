"""Where a body is after a load, and how far its voxels have moved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32

from service.core.arrays import GRID_SIZE, Eights, Occupancy, Probability
from service.core.columns import fill_column, fill_slab, scratch
from service.core.compiled import compiled
from service.core.displacement import Field


@dataclass(frozen=True, eq=False)
class Motion:
    """How a body's voxels have moved.

    Attributes:
        deformed: Voxels of the deformed body.
        moved_m: Displacement, along the axes of the grid, of the material now at each of them, in C order.
        max_m, mean_m: Lengths over the deformed body; 0 where it is empty.
    """

    deformed: Occupancy
    moved_m: Float32[np.ndarray, "axis=3 n"]
    max_m: float
    mean_m: float


def motion(field: Field, rest: Occupancy, probability: Probability, threshold: float, edge_m: float) -> Motion:
    """The body after a load, and the field at its voxels.

    Between its nodes it is trilinear, and beyond the outermost the last value holds. The lowest voxels of the body at
    rest do not move: they lie half a voxel above what is clamped.

    Args:
        field: Backward displacement in edges of the grid.
        rest: The body before the load.
        probability: That a voxel is in the body after it.
        threshold: Above which it is taken to be.
        edge_m: Edge of the grid in metres.
    """
    field, probability = np.ascontiguousarray(field), np.ascontiguousarray(probability)
    sole, edge, least = np.ascontiguousarray(rest[:, :, 0]), np.float32(edge_m), np.float32(threshold)
    deformed = np.empty(probability.shape, np.bool_)
    moved_m = np.empty((3, _tell_deformed(probability, least, deformed)), np.float32)
    longest_m, total_m = _gather(field, sole, deformed, deformed.view(np.uint64), edge, moved_m)
    return Motion(deformed, moved_m, longest_m, total_m / max(moved_m.shape[1], 1))


@compiled
def _tell_deformed(probability: Probability, threshold: np.float32, deformed: Occupancy) -> int:
    """Which voxels are above the threshold, and how many."""
    count = 0
    for x in range(GRID_SIZE):
        for y in range(GRID_SIZE):
            column = np.int32(0)
            for z in range(GRID_SIZE):
                above = probability[x, y, z] > threshold
                deformed[x, y, z] = above
                column = np.int32(column + np.int32(above))
            count += int(column)
    return count


@compiled
def _gather(
    field: Field, sole: Bool[np.ndarray, "x=64 y=64"], deformed: Occupancy, eights: Eights, edge_m: np.float32,
    moved_m: Float32[np.ndarray, "axis=3 n"],
) -> tuple[float, float]:  # fmt: skip
    """Metres at every filled voxel; returned are the greatest length and the sum of all."""
    coarse, slab, u = scratch()
    n, longest, total = 0, np.float32(0.0), 0.0
    for x in range(GRID_SIZE):
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
            before = n
            for z in range(GRID_SIZE):
                if deformed[x, y, z]:
                    moved_m[0, n], moved_m[1, n], moved_m[2, n] = edge_m * u[0, z], edge_m * u[1, z], edge_m * u[2, z]
                    n += 1
            for m in range(before, n):
                a, b, c = moved_m[0, m], moved_m[1, m], moved_m[2, m]
                length = np.sqrt(a * a + b * b + c * c)
                longest = max(longest, length)
                total += length
    return float(longest), total


@compiled
def _any(eights: Eights, x: int, y: int) -> bool:
    """Whether a column holds a filled voxel."""
    found = np.uint64(0)
    for eight in range(GRID_SIZE // 8):
        found |= eights[x, y, eight]
    return bool(found != 0)
