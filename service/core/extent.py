"""Which part of a grid a body fills."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from service.core.arrays import GRID_SIZE, Eights, Occupancy
from service.core.compiled import compiled

Voxel: TypeAlias = tuple[int, int, int]


def filled_range(occupancy: Occupancy) -> tuple[Voxel, Voxel] | None:
    """First voxel along each axis and the one after the last; None where there is none."""
    first, end = _filled_range(np.ascontiguousarray(occupancy).view(np.uint64))
    return (first, end) if end[0] else None


@compiled
def _filled_range(words: Eights) -> tuple[Voxel, Voxel]:
    """Eight voxels at a time."""
    above = np.zeros(words.shape[2], np.uint64)
    low_x, low_y, low_z, end_x, end_y, end_z = GRID_SIZE, GRID_SIZE, GRID_SIZE, 0, 0, 0
    for x in range(GRID_SIZE):
        for y in range(GRID_SIZE):
            some = np.uint64(0)
            for w in range(len(above)):
                some |= words[x, y, w]
                above[w] |= words[x, y, w]
            if some != 0:
                low_x, end_x, low_y, end_y = min(low_x, x), x + 1, min(low_y, y), max(end_y, y + 1)
    for z in range(GRID_SIZE):
        if above[z // 8] >> np.uint64(8 * (z % 8)) & np.uint64(1) != 0:
            low_z, end_z = min(low_z, z), z + 1
    return (low_x, low_y, low_z), (end_x, end_y, end_z)
