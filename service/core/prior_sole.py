"""Where in its lowest cells a body stands: weights that integrate over its sole alone."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from jaxtyping import Float32, Float64

from service.core.arrays import Occupancy
from service.core.extent import Voxel

GAUSS_3: Float64[np.ndarray, "3"] = 0.5 + np.sqrt(0.15) * np.array([-1.0, 0.0, 1.0])
"""Abscissae in [0, 1] of the Gauss rule of three points."""

HELD_ABOVE = 0.14
"""What counts as sole of a column of voxels that begins in the second layer. The simulator holds a body below 0.01 L;
the lowest voxels are its section at 0.0078, the next at 0.0234. What begins between them begins below 0.01 in as many
cases, and scanned bodies, whose soles are not flat, stand on little else."""

SoleWeights = Float32[np.ndarray, "9 x y"]


def sole_weights(occupancy: Occupancy, first: Voxel, end: Voxel, cells: tuple[int, int]) -> SoleWeights:
    """Weights of the 3×3 Gauss points of the faces on the floor of a box of voxels, in areas of a face.

    They integrate polynomials up to the second degree in each coordinate over the sole exactly, where `HELD_ABOVE` of
    what begins a layer above the floor counts; some may be negative. A body that rocks on a foot within one cell asks
    for the foot's own second moment.

    Args:
        occupancy: The body.
        first: First voxel of the box along each axis.
        end: The one after its last.
        cells: Along x and y.

    Source: moment fitting: Müller, Kummer and Oberlack, IJNME 96 (2013).
    """
    box = occupancy[first[0] : end[0], first[1] : end[1], first[2] : min(first[2] + 2, end[2])].astype(np.float32)
    sole = np.maximum(box[:, :, 0], np.float32(HELD_ABOVE) * box[:, :, -1])
    x, y = (_integrals(n, size) for n, size in zip(cells, sole.shape, strict=True))
    weights = (x.T @ sole @ y).reshape(cells[0], 3, cells[1], 3)
    return np.ascontiguousarray(weights.transpose(1, 3, 0, 2).reshape(9, *cells))


@lru_cache(maxsize=512)
def _integrals(cells: int, voxels: int) -> Float32[np.ndarray, "voxels points"]:
    """Integrals of the Lagrange polynomials of the Gauss points of `cells` cells over each of `voxels` voxels.

    Column 3·cell + point.
    """
    faces = np.clip(np.arange(voxels + 1)[:, None] * (cells / voxels) - np.arange(cells), 0.0, 1.0)
    table = np.empty((voxels, cells, 3), np.float32)
    for point in range(3):
        others = np.delete(GAUSS_3, point)
        polynomial = np.poly1d(others, r=True) / np.prod(GAUSS_3[point] - others)
        table[:, :, point] = np.diff(polynomial.integ()(faces), axis=0)
    return table.reshape(voxels, 3 * cells)
