"""Into how many cells a body's bounding box is divided, so that about as many as are wanted hold some of the body."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np

from service.core.arrays import Eights, Occupancy
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
    return _divide(np.ascontiguousarray(occupancy).view(np.uint64), first, end, cells)


@compiled
def _divide(words: Eights, first: Voxel, end: Voxel, cells: int) -> Division:
    """See `divide`."""
    size_x, size_y, size_z = end[0] - first[0], end[1] - first[1], end[2] - first[2]
    volume = float(size_x * size_y * size_z)
    most = max(min(volume / NARROWEST**3, float(LARGEST_SHARE * cells)), 1.0)
    box, best, nearest = FIRST_SHARE * cells, (1, 1, 1), np.inf
    for _ in range(_ROUNDS):
        width = (volume / min(box, most)) ** (1.0 / 3.0)
        division = _along(size_x, width), _along(size_y, width), _along(size_z, width)
        held = _held(words, first, (size_x, size_y, size_z), division)
        off = abs(np.log(held / cells))
        if off < nearest:
            best, nearest = division, off
        if box >= most or off < 0.1:
            break
        box *= cells / held
    return best


@compiled
def _along(voxels: int, width: float) -> int:
    """Cells of about a width in so many voxels."""
    return max(int(np.rint(voxels / width)), 1)


@compiled
def _cell_of(voxel: int, cells: int, voxels: int) -> int:
    """Which of the cells over so many voxels holds the centre of one."""
    return min(int((voxel + 0.5) * (cells / voxels)), cells - 1)


@compiled
def _held(words: Eights, first: Voxel, size: Voxel, division: Division) -> int:
    """Cells that hold the centre of a voxel. Columns of voxels in one column of cells are laid on each other first."""
    nx, ny, nz = division
    together = np.zeros((nx, ny, words.shape[2]), np.uint64)
    for x in range(size[0]):
        i = _cell_of(x, nx, size[0])
        for y in range(size[1]):
            column = together[i, _cell_of(y, ny, size[1])]
            for w in range(len(column)):
                column[w] |= words[first[0] + x, first[1] + y, w]
    count, one, layers = 0, np.uint64(1), np.empty(size[2], np.int64)
    for z in range(size[2]):
        layers[z] = _cell_of(z, nz, size[2])
    for i in range(nx):
        for j in range(ny):
            last = -1
            for z in range(size[2]):
                k = z + first[2]
                if layers[z] != last and together[i, j, k // 8] >> np.uint64(8 * (k % 8)) & one == one:
                    last = layers[z]
                    count += 1
    return count
