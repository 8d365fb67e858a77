"""How much of a body is in the octants of every cell, and of its sole in the quadrants of those on the floor."""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
from jaxtyping import Float32, Int

from service.core.arrays import Eights, Occupancy
from service.core.compiled import compiled
from service.core.extent import Voxel

Table = Float32[np.ndarray, "voxels halves"]
Octants = Float32[np.ndarray, "8 x y z"]
Quadrants = Float32[np.ndarray, "4 x y"]

HELD_ABOVE = 0.14
"""What counts as sole of a column of voxels that begins in the second layer. The simulator holds a body below 0.01 L;
the lowest voxels are its section at 0.0078, the next at 0.0234. What begins between them begins below 0.01 in as many
cases, and scanned bodies, whose soles are not flat, stand on little else."""

_EIGHT = np.uint64(0x0101010101010101)
"""Eight filled voxels."""


def octants(occupancy: Occupancy, first: Voxel, end: Voxel, cells: tuple[int, int, int]) -> tuple[Octants, Quadrants]:
    """What the octants 4·dx + 2·dy + dz of cells over a box of voxels hold, and the quadrants 2·dx + dy of its floor.

    In volumes of a cell (areas of its face), exact for the voxels; `HELD_ABOVE` of what begins a layer above the floor
    counts as sole.

    Args:
        occupancy: The body.
        first: First voxel of the box along each axis.
        end: The one after its last.
        cells: Along each axis.
    """
    x, y, z = (_halves(n, high - low) for n, low, high in zip(cells, first, end, strict=True))
    held, sole = np.empty((8, *cells), np.float32), np.empty((4, *cells[:2]), np.float32)
    words = np.ascontiguousarray(occupancy).view(np.uint64)
    _integrate(words, np.array(first), x, y, z, held, sole)
    return held, sole


@compiled
def _integrate(
    words: Eights, first: Int[np.ndarray, "3"], x: Table, y: Table, z: Table, held: Octants, sole: Quadrants
) -> None:
    """Lengths along columns of voxels, areas over their rows, and volumes over these.

    Eight voxels at a time are looked at, and one by one only where they are not like the one below. Loops run to
    lengths of arrays: were these known to the compiler, it would write the loops out.
    """
    one, lowest, shift = np.uint64(1), first[2] // 8, np.uint64(8 * (first[2] % 8))
    second = min(first[2] + 1, 8 * words.shape[2] - 1)
    next_shift = np.uint64(8 * (second % 8))
    size = z.shape[1]
    column = np.empty(size + 1, np.float32)  # at the end what stands on the floor
    plane = np.empty((y.shape[1], size + 1), np.float32)
    total = np.zeros((x.shape[1], y.shape[1], size + 1), np.float32)
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
                if words[first[0] + i, first[1] + j, lowest] >> shift & one:
                    column[size] = np.float32(1.0)
                elif words[first[0] + i, first[1] + j, second // 8] >> next_shift & one:
                    column[size] = np.float32(HELD_ABOVE)
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
            for part in range(len(sole)):
                sole[part, a, b] = total[2 * a + part // 2, 2 * b + part % 2, size]
            for part in range(len(held)):
                line = total[2 * a + part // 4, 2 * b + part // 2 % 2]
                for c in range(held.shape[3]):
                    held[part, a, b, c] = line[2 * c + part % 2]


@partial(compiled, apart=True)
def add_share(share: np.float32, values: Float32[np.ndarray, " n"], result: Float32[np.ndarray, " more"]) -> None:
    """Add a share of values to the first of others."""
    for i in range(len(values)):
        result[i] += share * values[i]


@lru_cache(maxsize=512)
def _halves(cells: int, voxels: int) -> Table:
    """How much of each half of each cell, in edges of a cell, is below each face between voxels."""
    place = np.arange(voxels + 1)[:, None] * (2.0 * cells / voxels)
    return np.asarray(0.5 * np.clip(place - np.arange(2 * cells), 0.0, 1.0), np.float32)
