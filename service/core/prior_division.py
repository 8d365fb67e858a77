"""Into how many cells a body's bounding box is divided, so that about as many as are wanted hold some of the body."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from jaxtyping import Int

from service.core.arrays import GRID_SIZE, Eights, Occupancy
from service.core.compiled import compiled
from service.core.extent import Voxel

Division: TypeAlias = tuple[int, int, int]
"""Cells along x, y, z."""

FIRST_SHARE, LARGEST_SHARE = 1.5, 8
"""Cells of the box for each that is wanted: as many as most bodies need, and at most."""

NARROWEST = 2.0
"""Voxels that a cell is wide at least, about: what is narrower resolves how voxels round a body."""

_ROUNDS = 3
"""Of correcting the number of cells of the box."""


def divide(occupancy: Occupancy, first: Voxel, end: Voxel, cells: int) -> Division:
    """Cells about as wide as high, of which about `cells` hold the centre of a voxel of the body.

    Args:
        occupancy: The body.
        first: First voxel of its box along each axis.
        end: The one after its last.
        cells: At least 1.
    """
    size = np.subtract(end, first)
    most = max(min(float(size.prod()) / NARROWEST**3, float(LARGEST_SHARE * cells)), 1.0)
    words = np.ascontiguousarray(occupancy).view(np.uint64)
    box, best, nearest = FIRST_SHARE * cells, (1, 1, 1), np.inf
    for _ in range(_ROUNDS):
        division = _division(size, min(box, most))
        held = _held(words, np.array(first), _cell_of_voxel(size, division), division)
        if (off := abs(np.log(held / cells))) < nearest:
            best, nearest = division, off
        if box >= most or off < 0.1:
            break
        box *= cells / held
    return best


def _division(size: Int[np.ndarray, "3"], cells: float) -> Division:
    width = (size.prod() / cells) ** (1.0 / 3.0)
    nx, ny, nz = np.maximum(np.round(size / width), 1).astype(int).tolist()
    return nx, ny, nz


def _cell_of_voxel(size: Int[np.ndarray, "3"], division: Division) -> Int[np.ndarray, "3 voxel=64"]:
    """Along each axis the cell that holds the centre of a voxel of the box."""
    centres = np.arange(GRID_SIZE) + 0.5
    cells = centres * np.divide(division, size)[:, None]
    return np.asarray(np.minimum(cells, np.subtract(division, 1)[:, None]).astype(int))


@compiled
def _held(words: Eights, first: Int[np.ndarray, "3"], cell: Int[np.ndarray, "3 voxel=64"], division: Division) -> int:
    """Cells that hold the centre of a voxel. Columns of voxels in one column of cells are laid on each other first."""
    nx, ny, _ = division
    together = np.zeros((nx, ny, words.shape[2]), np.uint64)
    for x in range(GRID_SIZE - first[0]):
        for y in range(GRID_SIZE - first[1]):
            column = together[cell[0, x], cell[1, y]]
            for w in range(len(column)):
                column[w] |= words[first[0] + x, first[1] + y, w]
    count, one = 0, np.uint64(1)
    for i in range(nx):
        for j in range(ny):
            last = -1
            for z in range(GRID_SIZE - first[2]):
                k = z + first[2]
                if cell[2, z] != last and together[i, j, k // 8] >> np.uint64(8 * (k % 8)) & one == one:
                    last = cell[2, z]
                    count += 1
    return count
