"""Displacements of coarse nodes at rest on the lattice that the deformation network reads."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32

from service.core.prior_grid import CellGrid

LATTICE_SIZE = 16
"""Nodes of the lattice along each edge; node i lies at (i + ½)/16."""

Lattices = Float32[np.ndarray, "loads axis=3 x=16 y=16 z=16"]


def forward_lattice(grid: CellGrid, nodal: Float32[np.ndarray, "3 loads n"]) -> Lattices:
    """u(x) at rest: trilinear in the cells, held constant outside the box that they fill.

    Places of the box without a node take the mean of their neighbours that have a value, from the body outwards.

    Args:
        grid: Cells of the body.
        nodal: Displacement of every node, in edges of the body grid.
    """
    _, loads, _ = nodal.shape
    corners = tuple(cells + 1 for cells in grid.shape)
    box = np.zeros((3 * loads, *corners), np.float32)
    known = np.zeros(corners, bool)
    place = tuple(grid.nodes.T)
    box[(slice(None), *place)] = nodal.reshape(3 * loads, -1)
    known[place] = True
    values = _spread(box, known)
    for axis in range(3):
        table = _interpolation(float(grid.low[axis]), float(grid.edges[axis]), corners[axis])
        values = np.moveaxis(np.tensordot(table, values, axes=(1, axis + 1)), 0, axis + 1)
    return np.ascontiguousarray(values.reshape(3, loads, *(LATTICE_SIZE,) * 3).swapaxes(0, 1))


def _spread(
    values: Float32[np.ndarray, "c x y z"], known: Bool[np.ndarray, "x y z"]
) -> Float32[np.ndarray, "c x y z"]:
    """The values, carried on step by step to where none is known."""
    known = known.copy()
    while not known.all():
        total, count = np.zeros_like(values), np.zeros(known.shape, np.float32)
        for axis in range(3):
            ahead: list[slice] = [slice(None)] * 3
            behind: list[slice] = [slice(None)] * 3
            ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
            for to, of in ((tuple(ahead), tuple(behind)), (tuple(behind), tuple(ahead))):
                total[(slice(None), *to)] += values[(slice(None), *of)]
                count[to] += known[of]
        reached = ~known & (count > 0)
        values[:, reached] = total[:, reached] / count[reached]
        known |= reached
    return values


def _interpolation(low: float, edge: float, nodes: int) -> Float32[np.ndarray, "lattice nodes"]:
    """Weights of a row of nodes at the places of the lattice, held at its ends."""
    place = np.clip(((np.arange(LATTICE_SIZE) + 0.5) / LATTICE_SIZE - low) / edge, 0.0, nodes - 1.0)
    below = np.minimum(np.floor(place).astype(int), nodes - 2)
    table = np.zeros((LATTICE_SIZE, nodes), np.float32)
    table[np.arange(LATTICE_SIZE), below] = 1.0 - (place - below)
    table[np.arange(LATTICE_SIZE), below + 1] = place - below
    return table
