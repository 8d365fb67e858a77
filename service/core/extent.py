"""Which part of a grid a body fills."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from jaxtyping import UInt8

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.compiled import compiled

Voxel: TypeAlias = tuple[int, int, int]


def filled_range(occupancy: Occupancy) -> tuple[Voxel, Voxel] | None:
    """First voxel along each axis and the one after the last; None where there is none."""
    first, end = _filled_range(np.ascontiguousarray(occupancy).view(np.uint8))
    return (first, end) if end[0] else None


@compiled
def _filled_range(occupancy: UInt8[np.ndarray, "x=64 y=64 z=64"]) -> tuple[Voxel, Voxel]:
    above = np.zeros(GRID_SIZE, np.uint8)
    low_x, low_y, low_z, end_x, end_y, end_z = GRID_SIZE, GRID_SIZE, GRID_SIZE, 0, 0, 0
    for x in range(GRID_SIZE):
        for y in range(GRID_SIZE):
            some = np.uint8(0)
            for z in range(GRID_SIZE):
                some |= occupancy[x, y, z]
                above[z] |= occupancy[x, y, z]
            if some:
                low_x, end_x, low_y, end_y = min(low_x, x), x + 1, min(low_y, y), max(end_y, y + 1)
    for z in range(GRID_SIZE):
        if above[z]:
            low_z, end_z = min(low_z, z), z + 1
    return (low_x, low_y, low_z), (end_x, end_y, end_z)
