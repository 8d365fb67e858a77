"""Displacements of coarse nodes at rest on the lattice that the deformation network reads."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Int

from service.core.compiled import compiled
from service.core.prior_grid import CellGrid

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
    box = np.zeros((3 * len(nodal), x * y * z), np.float32)
    when = np.full((x, y, z), -1)
    place = np.ravel_multi_index(tuple(grid.nodes.T), (x, y, z))
    box[:, place] = nodal.reshape(len(box), -1)
    when.ravel()[place] = 0
    _spread(box, when)
    tables = [_interpolation(float(grid.low[axis]), float(grid.edges[axis]), grid.shape[axis] + 1) for axis in range(3)]
    along_z = box.reshape(-1, z) @ tables[2].T
    along_y = np.matmul(tables[1], along_z.reshape(-1, y, LATTICE_SIZE))
    along_x = np.matmul(tables[0], along_y.reshape(-1, x, LATTICE_SIZE**2))
    return np.asarray(along_x.reshape(-1, 3, *(LATTICE_SIZE,) * 3))


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


def _interpolation(low: float, edge: float, nodes: int) -> Float32[np.ndarray, "lattice nodes"]:
    """Weights of a row of nodes at the places of the lattice, held at its ends."""
    place = np.clip(((np.arange(LATTICE_SIZE) + 0.5) / LATTICE_SIZE - low) / edge, 0.0, nodes - 1.0)
    below = np.minimum(np.floor(place).astype(int), nodes - 2)
    table = np.zeros((LATTICE_SIZE, nodes), np.float32)
    table[np.arange(LATTICE_SIZE), below] = 1.0 - (place - below)
    table[np.arange(LATTICE_SIZE), below + 1] = place - below
    return table
