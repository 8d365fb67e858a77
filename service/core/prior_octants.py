"""How much of a body is in the octants of every cell."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float32, Int

from service.core.arrays import Eights, Occupancy
from service.core.compiled import compiled
from service.core.extent import Voxel
from service.core.vectors import add_share

Table = Float32[np.ndarray, "voxels halves"]
Octants = Float32[np.ndarray, "8 x y z"]

_EIGHT = np.uint64(0x0101010101010101)
"""Eight filled voxels."""


def octants(occupancy: Occupancy, first: Voxel, end: Voxel, cells: tuple[int, int, int]) -> Octants:
    """What the octants 4·dx + 2·dy + dz of cells over a box of voxels hold, in volumes of a cell; exact for the voxels.

    Args:
        occupancy: The body.
        first: First voxel of the box along each axis.
        end: The one after its last.
        cells: Along each axis.
    """
    x, y, z = (_halves(n, high - low) for n, low, high in zip(cells, first, end, strict=True))
    held = np.empty((8, *cells), np.float32)
    _integrate(np.ascontiguousarray(occupancy).view(np.uint64), np.array(first), x, y, z, held)
    return held


@compiled
def _integrate(words: Eights, first: Int[np.ndarray, "3"], x: Table, y: Table, z: Table, held: Octants) -> None:
    """Lengths along columns of voxels, areas over their rows, and volumes over these.

    Eight voxels at a time are looked at, and one by one only where they are not like the one below. Loops run to
    lengths of arrays: were these known to the compiler, it would write the loops out.
    """
    one, size = np.uint64(1), z.shape[1]
    column, plane = np.empty(size, np.float32), np.empty((y.shape[1], size), np.float32)
    total = np.zeros((x.shape[1], y.shape[1], size), np.float32)
    for i in range(len(x) - 1):
        plane[...] = 0.0
        for j in range(len(y) - 1):
            column[:] = 0.0
            empty, below = True, False
            for w in range(words.shape[2] + 1):  # above the last there is nothing
                word = words[first[0] + i, first[1] + j, w] if w < words.shape[2] else np.uint64(0)
                if word != (_EIGHT if below else np.uint64(0)):
                    for k in range(words.shape[2]):  # as many as there are words
                        filled = word & one == one
                        if filled != below:  # a run of voxels begins, or has ended
                            add_share(np.float32(1.0) if below else np.float32(-1.0), z[8 * w + k - first[2]], column)
                            empty, below = False, filled
                        word >>= np.uint64(8)
            if not empty:
                for q in range(len(plane)):
                    share = y[j + 1, q] - y[j, q]
                    if share != 0.0:  # a voxel is in one cell or in two
                        add_share(share, column, plane[q])
        for p in range(len(total)):
            share = x[i + 1, p] - x[i, p]
            if share != 0.0:
                for q in range(len(plane)):
                    add_share(share, plane[q], total[p, q])
    for a in range(held.shape[1]):
        for b in range(held.shape[2]):
            for part in range(len(held)):
                line = total[2 * a + part // 4, 2 * b + part // 2 % 2]
                for c in range(held.shape[3]):
                    held[part, a, b, c] = line[2 * c + part % 2]


@lru_cache(maxsize=512)
def _halves(cells: int, voxels: int) -> Table:
    """How much of each half of each cell, in edges of a cell, is below each face between voxels."""
    place = np.arange(voxels + 1)[:, None] * (2.0 * cells / voxels)
    return np.asarray(0.5 * np.clip(place - np.arange(2 * cells), 0.0, 1.0), np.float32)
