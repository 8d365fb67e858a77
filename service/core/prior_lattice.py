"""Displacements of coarse nodes at rest on the lattice that the deformation network reads."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Int

from service.core.compiled import compiled
from service.core.prior_grid import CellGrid
from service.core.prior_interpolation import interpolate

LATTICE_SIZE = 16
"""Nodes of the lattice along each edge; node i lies at (i + ½)/16."""

Lattices = Float32[np.ndarray, "loads axis=3 x=16 y=16 z=16"]


def forward_lattice(grid: CellGrid, nodal: Float32[np.ndarray, "loads 3 n"]) -> Lattices:
    """u(x) at rest: trilinear in the cells, held constant outside the box that they fill.

    Places of the box without a node take the mean of their neighbours that have a value, from the body outwards.

    Args:
        grid: Cells of the body.
        nodal: Displacement of every node, in edges of the body grid.
    """
    x, y, z = (cells + 1 for cells in grid.shape)
    box = np.zeros((3 * len(nodal), x, y, z), np.float32)
    when = np.full((x, y, z), -1)
    place = (grid.nodes[:, 0] * y + grid.nodes[:, 1]) * z + grid.nodes[:, 2]
    box.reshape(len(box), -1)[:, place] = nodal.reshape(len(box), -1)
    when.ravel()[place] = 0
    _spread(box.reshape(len(box), -1), when)
    size = LATTICE_SIZE
    first, step = (
        ((0.5 / size - grid.low) / grid.edges).astype(np.float32),
        (1.0 / size / grid.edges).astype(np.float32),
    )
    along_z, along_y = (
        np.empty((len(box) * x * y, size, 1), np.float32),
        np.empty((len(box) * x, size, size), np.float32),
    )
    result = np.empty((len(box), size, size * size), np.float32)
    held = np.float32(0.0)
    interpolate(box.reshape(-1, z, 1), first[2], step[2], held, along_z)
    interpolate(along_z.reshape(-1, y, size), first[1], step[1], held, along_y)
    interpolate(along_y.reshape(-1, x, size * size), first[0], step[0], held, result)
    return result.reshape(-1, 3, size, size, size)


@compiled
def _spread(values: Float32[np.ndarray, "c places"], when: Int[np.ndarray, "x y z"]) -> None:
    """Carry the values on, step by step, to where none is known.

    Args:
        values: At the places of the box.
        when: The step in which each place got its values: 0 where they are given, -1 where they are not known yet.
    """
    size_x, size_y, size_z = when.shape
    step, missing = 0, True
    while missing:
        step, missing = step + 1, False
        for x in range(size_x):
            for y in range(size_y):
                for z in range(size_z):
                    if when[x, y, z] < 0 and not _take_mean(values, when, x, y, z, step):
                        missing = True


@compiled
def _take_mean(
    values: Float32[np.ndarray, "c places"], when: Int[np.ndarray, "x y z"], x: int, y: int, z: int, step: int
) -> bool:
    """Give a place the mean of its neighbours that had values before this step; False where there are none."""
    size_x, size_y, size_z = when.shape
    known = 0
    neighbours = np.empty(6, np.int64)
    for axis in range(3):
        for side in (-1, 1):
            i, j, k = x + side * (axis == 0), y + side * (axis == 1), z + side * (axis == 2)
            if 0 <= i < size_x and 0 <= j < size_y and 0 <= k < size_z and 0 <= when[i, j, k] < step:
                neighbours[known] = (i * size_y + j) * size_z + k
                known += 1
    if known:
        when[x, y, z] = step
        for c in range(len(values)):
            total = np.float32(0.0)
            for other in neighbours[:known]:
                total += values[c, other]
            values[c, (x * size_y + y) * size_z + z] = total / np.float32(known)
    return known > 0
