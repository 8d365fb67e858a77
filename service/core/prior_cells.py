"""The cells of a coarse solve as compiled loops see them, and what these do with the cells of one load.

Components come first and cells last: the inner loops are as long as there are cells, and treat eight at once.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int

from service.core.compiled import compiled
from service.core.prior_element import Element, floor_stiffness, rest_stiffness
from service.core.prior_grid import CORNERS, CellGrid
from service.core.prior_rotation import Matrices, Nine

_BLOCK = 8
"""The cells are filled up to a multiple of this with such as have no stiffness; there is one at least."""

_NINE_ZEROS = (np.float32(0.0),) * 9
_LOWER = np.flatnonzero(CORNERS[:, 2] == 0)

Nodal = Float32[np.ndarray, "3 n"]
Corners = Float32[np.ndarray, "8 3 k"]


class Cells(NamedTuple):
    """The cells of a body, k with those that only fill up.

    Attributes:
        own: How many are the body's; those after them have no stiffness.
        nodes: Node of each corner.
        element: Their material.
        stiffness: Of each cell at rest, local degree of freedom 3·corner + axis.
        rest: Place of each corner from the centre of its cell.
        around: The cell that has this node as its corner a; one without stiffness where there is none.
        share: Its share of the material around the node.
        sole: Nodes under the floor cells.
        bed: Stiffness of the bed between them, the same along each axis.
    """

    own: int
    nodes: Int[np.ndarray, "8 k"]
    element: Element
    stiffness: Float32[np.ndarray, "24 24 k"]
    rest: Float32[np.ndarray, "8 3"]
    around: Int[np.ndarray, "8 n"]
    share: Float32[np.ndarray, "8 n"]
    sole: Int[np.ndarray, "4 b"]
    bed: Float32[np.ndarray, "4 4 b"]

    @classmethod
    def of(cls, grid: CellGrid, poisson_ratio: float) -> Cells:
        """The cells of a grid.

        Args:
            grid: The cells.
            poisson_ratio: ν in [0, 0.49].
        """
        m, n = len(grid.cells), len(grid.nodes)
        k = m // _BLOCK * _BLOCK + _BLOCK
        nodes, around, share = np.zeros((8, k), np.int64), np.full((8, n), m), np.zeros((8, n), np.float32)
        _list_cells(grid.cell_nodes, np.maximum(grid.fill, np.float32(1e-3)), nodes, around, share)
        element = Element.of(grid, poisson_ratio, k)
        return cls(
            own=m, nodes=nodes, element=element, stiffness=rest_stiffness(element),
            rest=((CORNERS - 0.5) * grid.edges).astype(np.float32), around=around, share=share,
            sole=nodes[_LOWER[:, None], grid.floor_cells], bed=floor_stiffness(grid),
        )  # fmt: skip


@compiled
def _list_cells(
    cell_nodes: Int[np.ndarray, "m 8"], fill: Float32[np.ndarray, " m"], nodes: Int[np.ndarray, "8 k"],
    around: Int[np.ndarray, "8 n"], share: Float32[np.ndarray, "8 n"],
) -> None:  # fmt: skip
    """Write the nodes of every cell, and of every node its cells and their shares, which are 0 before."""
    for c in range(len(cell_nodes)):
        for a in range(len(share)):
            v = cell_nodes[c, a]
            nodes[a, c], around[a, v], share[a, v] = v, c, fill[c]
    for v in range(around.shape[1]):
        total = np.float32(0.0)
        for a in range(len(share)):
            total += share[a, v]
        for a in range(len(share)):
            share[a, v] /= total


@compiled
def at_corners(cells: Cells, values: Nodal, result: Corners) -> None:
    """Values of the nodes at the corners of the cells."""
    for a in range(len(result)):
        node = cells.nodes[a]
        for i in range(len(values)):
            of, row = values[i], result[a, i]
            for c in range(len(row)):
                row[c] = of[node[c]]


@partial(compiled, apart=True)
def gradients(cells: Cells, corners: Corners, result: Matrices) -> None:
    """∂/∂X of a field at the centre of every cell; also its mean over the cell."""
    for j in range(result.shape[1]):
        by = np.float32(0.125) / cells.rest[7, j]
        for i in range(len(result)):
            row = result[i, j]
            # corner 4·dx + 2·dy + dz: those before and behind along axis j
            step = 4 >> j
            first = 2 if j == 0 else 4
            last = 1 if j < 2 else 2
            low_0, high_0 = corners[0, i], corners[step, i]
            low_1, high_1 = corners[last, i], corners[last + step, i]
            low_2, high_2 = corners[first, i], corners[first + step, i]
            low_3, high_3 = corners[first + last, i], corners[first + last + step, i]
            for c in range(len(row)):
                high = (high_0[c] + high_1[c]) + (high_2[c] + high_3[c])
                row[c] = by * (high - ((low_0[c] + low_1[c]) + (low_2[c] + low_3[c])))


@partial(compiled, apart=True)
def cell_forces(cells: Cells, displacement: Corners, result: Corners) -> None:
    """Stiffness times displacement."""
    u, forces = displacement.reshape(24, -1), result.reshape(24, -1)
    for a in range(len(forces)):
        force = forces[a]
        force[:] = 0.0
        for b in range(0, len(u), 4):
            row_0, row_1 = cells.stiffness[a, b], cells.stiffness[a, b + 1]
            row_2, row_3 = cells.stiffness[a, b + 2], cells.stiffness[a, b + 3]
            u_0, u_1, u_2, u_3 = u[b], u[b + 1], u[b + 2], u[b + 3]
            for c in range(len(force)):
                force[c] += row_0[c] * u_0[c] + row_1[c] * u_1[c] + row_2[c] * u_2[c] + row_3[c] * u_3[c]


@compiled
def at_nodes(cells: Cells, corners: Corners, result: Nodal) -> None:
    """Sums over the cells around each node."""
    for i in range(len(result)):
        row = result[i]
        row[:] = 0.0
        for a in range(len(corners)):
            of, cell = corners[a, i], cells.around[a]
            for v in range(len(row)):
                row[v] += of[cell[v]]


@compiled
def mean_at_nodes(cells: Cells, matrices: Matrices, result: Matrices) -> None:
    """Means over the cells around each node, by the material they hold."""
    nine = np.empty((matrices.shape[2], 9), np.float32)  # those of a cell side by side
    for i in range(3):
        for j in range(3):
            for c in range(len(nine)):
                nine[c, 3 * i + j] = matrices[i, j, c]
    for v in range(result.shape[2]):
        sums = _NINE_ZEROS
        for a in range(len(cells.around)):
            sums = _added(sums, cells.share[a, v], nine[cells.around[a, v]])
        result[0, 0, v], result[0, 1, v], result[0, 2, v] = sums[0], sums[1], sums[2]
        result[1, 0, v], result[1, 1, v], result[1, 2, v] = sums[3], sums[4], sums[5]
        result[2, 0, v], result[2, 1, v], result[2, 2, v] = sums[6], sums[7], sums[8]


@compiled
def _added(sums: Nine, share: np.float32, values: Float32[np.ndarray, "9"]) -> Nine:
    a, b, c, d, e, f, g, h, i = sums
    return (
        a + share * values[0], b + share * values[1], c + share * values[2],
        d + share * values[3], e + share * values[4], f + share * values[5],
        g + share * values[6], h + share * values[7], i + share * values[8],
    )  # fmt: skip


@compiled
def add_bed(cells: Cells, u: Nodal, force: Nodal) -> None:
    """Forces of the bed under the sole."""
    for i in range(len(u)):
        for a in range(len(cells.sole)):
            for b in range(len(cells.sole)):
                for f in range(cells.sole.shape[1]):
                    force[i, cells.sole[a, f]] += cells.bed[a, b, f] * u[i, cells.sole[b, f]]
