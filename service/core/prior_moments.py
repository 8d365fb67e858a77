"""How much of a body is around the Gauss points of every cell: weights that integrate over the material alone."""

from __future__ import annotations

from functools import lru_cache, partial

import numpy as np
from jaxtyping import Float32, Float64, Int

from service.core.arrays import Eights, Occupancy
from service.core.compiled import compiled
from service.core.extent import Voxel

GAUSS_3: Float64[np.ndarray, "3"] = 0.5 + np.sqrt(0.15) * np.array([-1.0, 0.0, 1.0])
"""Abscissae in [0, 1] of the Gauss rule of three points."""

Table = Float32[np.ndarray, "voxels points"]
Weights = Float32[np.ndarray, "27 x y z"]
FloorWeights = Float32[np.ndarray, "9 x y"]

HELD_ABOVE = 0.14
"""What counts as sole of a column of voxels that begins in the second layer. The simulator holds a body below 0.01 L;
the lowest voxels are its section at 0.0078, the next at 0.0234. What begins between them begins below 0.01 in as many
cases, and scanned bodies, whose soles are not flat, stand on little else."""

_EIGHT = np.uint64(0x0101010101010101)
"""Eight filled voxels."""


def quadrature_weights(
    occupancy: Occupancy, first: Voxel, end: Voxel, cells: tuple[int, int, int]
) -> tuple[Weights, FloorWeights]:
    """Weights of the 3×3×3 Gauss points of cells over a box of voxels, and of the 3×3 of their faces on its floor.

    They integrate polynomials up to the second degree in each coordinate over the material exactly, in volumes of a
    cell (areas of its face), where `HELD_ABOVE` of what begins a layer above the floor counts; some may be negative.

    Args:
        occupancy: The body.
        first: First voxel of the box along each axis.
        end: The one after its last.
        cells: Along each axis.

    Source: moment fitting: Müller, Kummer and Oberlack, IJNME 96 (2013).
    """
    x, y, z = (_integrals(n, high - low) for n, low, high in zip(cells, first, end, strict=True))
    weights = np.empty((27, *cells), np.float32)
    floor = np.empty((9, *cells[:2]), np.float32)
    words = np.ascontiguousarray(occupancy).view(np.uint64)
    _integrate(words, np.array(first), x, y, z, weights, floor)
    return weights, floor


@compiled
def _integrate(
    words: Eights, first: Int[np.ndarray, "3"], x: Table, y: Table, z: Table, weights: Weights, floor: FloorWeights
) -> None:
    """Integrals along columns of voxels, over their rows, and over these: each table is a factor of the polynomials.

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
    for a in range(weights.shape[1]):
        for b in range(weights.shape[2]):
            for point in range(len(floor)):
                floor[point, a, b] = total[3 * a + point // 3, 3 * b + point % 3, size]
            for point in range(len(weights)):
                line = total[3 * a + point // 9, 3 * b + point // 3 % 3]
                for c in range(weights.shape[3]):
                    weights[point, a, b, c] = line[3 * c + point % 3]


@partial(compiled, apart=True)
def add_share(share: np.float32, values: Float32[np.ndarray, " n"], result: Float32[np.ndarray, " more"]) -> None:
    """Add a share of values to the first of others."""
    for i in range(len(values)):
        result[i] += share * values[i]


@lru_cache(maxsize=512)
def _integrals(cells: int, voxels: int) -> Table:
    """Integrals of the Lagrange polynomials of the Gauss points over their cell up to each face between voxels.

    Column 3·cell + point; `cells` cells over `voxels` voxels.
    """
    up_to = np.clip(np.arange(voxels + 1)[:, None] * (cells / voxels) - np.arange(cells), 0.0, 1.0)
    table = np.empty((voxels + 1, cells, 3), np.float32)
    for point in range(3):
        others = np.delete(GAUSS_3, point)
        polynomial = np.poly1d(others, r=True) / np.prod(GAUSS_3[point] - others)
        table[:, :, point] = polynomial.integ()(up_to)
    return table.reshape(voxels + 1, 3 * cells)
