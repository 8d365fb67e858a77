"""Where a body may have come to: how high the voxels reach that a displacement field brings from its box."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from jaxtyping import Int64

from service.core.arrays import GRID_SIZE
from service.core.compiled import compiled
from service.core.displacement import STEPS, Field
from service.core.extent import Voxel
from service.core.prior_field import FIELD_SIZE

CELLS = FIELD_SIZE + 1
"""Cells of the field along each edge of the grid: between neighbouring nodes, and beyond the outermost."""

Tops: TypeAlias = Int64[np.ndarray, "x=33 y=33"]
"""Of each column of cells: the voxel after the last that is looked up, 0 for none."""

_REACH = 1.01
"""Voxels beyond the box that count as it: half a one in which the values fall to zero, half a one that the outermost
voxels lie beyond the outermost nodes, and a little for rounding."""


@compiled
def cells_of(first_x: int, end_x: int) -> tuple[int, int]:
    """Cells along x that some voxels lie in: cell c holds the voxels 2 c - 1 and 2 c, between nodes c - 1 and c."""
    return (first_x + 1) // 2, end_x // 2 + 1


@compiled
def nodes_of(first_x: int, end_x: int) -> tuple[int, int]:
    """Nodes along x on either side of some voxels."""
    first, end = cells_of(first_x, end_x)
    return max(first - 1, 0), min(end, FIELD_SIZE)


@compiled
def tell_tops(field: Field, first: Voxel, end: Voxel, first_cell: int, end_cell: int, tops: Tops) -> None:
    """How high the voxels reach that may come from the box of voxels from `first` to before `end`, in some cells.

    A voxel comes from somewhere between the places that the eight nodes around it come from. If all of these lie
    beyond one and the same side of the box, so does the voxel's.
    """
    low_x, low_y, low_z = _edge(first[0], -_REACH), _edge(first[1], -_REACH), _edge(first[2], -_REACH)
    high_x, high_y, high_z = _edge(end[0], _REACH), _edge(end[1], _REACH), _edge(end[2], _REACH)
    beyond = np.empty((2, FIELD_SIZE, FIELD_SIZE), np.uint8)  # a bit for each side, of the nodes of two x
    row = np.empty(FIELD_SIZE, np.uint8)
    for i in range(max(first_cell - 1, 0), end_cell):
        if i < FIELD_SIZE:
            for j in range(FIELD_SIZE):
                for k in range(FIELD_SIZE):
                    x, y = STEPS[i] - field[0, i, j, k], STEPS[j] - field[1, i, j, k]
                    z = STEPS[k] - field[2, i, j, k]
                    side_x = np.uint8(x < low_x) | np.uint8(x > high_x) << np.uint8(1)
                    side_y = np.uint8(y < low_y) | np.uint8(y > high_y) << np.uint8(1)
                    side_z = np.uint8(z < low_z) | np.uint8(z > high_z) << np.uint8(1)
                    beyond[i % 2, j, k] = side_x | side_y << np.uint8(2) | side_z << np.uint8(4)
        if i < first_cell:
            continue
        here, before = min(i, FIELD_SIZE - 1) % 2, max(i - 1, 0) % 2
        for j in range(CELLS):
            upper, lower = min(j, FIELD_SIZE - 1), max(j - 1, 0)
            for k in range(FIELD_SIZE):
                row[k] = beyond[here, upper, k] & beyond[here, lower, k]
                row[k] &= beyond[before, upper, k] & beyond[before, lower, k]
            top = CELLS
            while top > 0 and row[max(top - 2, 0)] & row[min(top - 1, FIELD_SIZE - 1)]:
                top -= 1
            tops[i, j] = min(2 * top - 1, GRID_SIZE) if top else 0
            # the lowest voxels of the body do not move, whatever the field says
            if first[0] <= 2 * i <= end[0] and first[1] <= 2 * j <= end[1]:
                tops[i, j] = max(tops[i, j], 1)


@compiled
def _edge(voxel: int, beyond: float) -> np.float32:
    """Where a voxel begins, in edges of the grid."""
    return np.float32((voxel + beyond) / GRID_SIZE)
