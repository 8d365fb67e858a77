"""The few hexahedral cells that the coarse elastic solve knows a body by, and how much material each holds.

The cells fill the body's bounding box rather than the cube, so that all of them are spent on the body; they are about
as wide as high. Everything is in edges of the body grid, z up.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Float64, Int, UInt8

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.compiled import compiled
from service.core.extent import filled_range
from service.core.prior_division import divide
from service.core.prior_octants import Octants, octants
from service.core.prior_sole import SoleWeights, sole_weights

CORNERS: Int[np.ndarray, "8 3"] = np.array([[a >> 2 & 1, a >> 1 & 1, a & 1] for a in range(8)])
"""Corner (dx, dy, dz) of local node a = 4·dx + 2·dy + dz."""

MIN_FILL = 0.01
"""Cells holding less material than this are left out."""


Box = UInt8[np.ndarray, "x+2 y+2 z+2"]


@dataclass(frozen=True, eq=False)
class CellGrid:
    """Cells with material that stand on the floor of the body, and their nodes.

    Attributes:
        low: Lowest corner of the box.
        edges: Edges of a cell along x, y, z.
        shape: Cells along x, y, z.
        cells: Index of every kept cell in the box.
        octants: Material in each octant 4·dx + 2·dy + dz of each cell, in volumes of a cell.
        fill: Part of each cell that holds material.
        nodes: Index of every node in the box, from 0 to `shape`; those of a cell have numbers that lie near.
        cell_nodes: Node number of each corner of each cell, corner 4·dx + 2·dy + dz.
        floor_cells: Which cells stand on the floor.
        sole_weights: Quadrature weight of each of the 3×3 Gauss points of their lower faces, see `sole_weights`.
    """

    low: Float64[np.ndarray, "3"]
    edges: Float64[np.ndarray, "3"]
    shape: tuple[int, int, int]
    cells: Int[np.ndarray, "m 3"]
    octants: Float32[np.ndarray, "8 m"]
    fill: Float32[np.ndarray, " m"]
    nodes: Int[np.ndarray, "n 3"]
    cell_nodes: Int[np.ndarray, "m 8"]
    floor_cells: Int[np.ndarray, " b"]
    sole_weights: Float32[np.ndarray, "9 b"]
    _cell_of_box: Int[np.ndarray, "x y z"]

    @classmethod
    def fit(cls, occupancy: Occupancy, cells: int) -> CellGrid:
        """Lay cells over the bounding box of a body of which about `cells` hold material.

        Raises:
            ValueError: The body is empty.
        """
        filled = filled_range(occupancy)
        if filled is None:
            raise ValueError("an empty body has no elastic solution: the occupancy holds no voxel")
        first, end = filled
        low = np.array(first) / GRID_SIZE
        extent = np.array(end) / GRID_SIZE - low
        nx, ny, nz = shape = divide(occupancy, first, end, cells)
        held = octants(occupancy, first, end, (nx, ny, nz))
        sole = sole_weights(occupancy, first, end, (nx, ny))
        kept = np.zeros((nx + 2, ny + 2, nz + 2), np.uint8)  # with nothing all around
        count = _keep(held, sole, np.float32(MIN_FILL), kept)
        if count == 0:  # a body that touches the floor with a few voxels only
            count = _keep(held, sole, np.float32(1e-6), kept)
        # numbered plane by plane along the longest axis, row by row along the next one: nodes of a cell are then near
        longest, middle, shortest = sorted(range(3), key=lambda axis: -shape[axis])
        cell_of_box, chosen, nodes, corners, own, fill = _number(kept, count, (longest, middle, shortest), held)
        floor_cells, own_sole = _stand(chosen, sole)
        return cls(
            low=low, edges=extent / shape, shape=shape, cells=chosen, octants=own, fill=fill,
            nodes=nodes, cell_nodes=corners, floor_cells=floor_cells, sole_weights=own_sole,
            _cell_of_box=cell_of_box,
        )  # fmt: skip

    @property
    def floor(self) -> int:
        """Lowest layer of voxels of the box."""
        return round(float(self.low[2]) * GRID_SIZE)

    @property
    def node_positions(self) -> Float64[np.ndarray, "n 3"]:
        """Rest position of every node."""
        return np.asarray(self.low + self.nodes * self.edges)

    def at_nodes(
        self, points: Float32[np.ndarray, "3 k"], values: Float32[np.ndarray, " k"]
    ) -> Float32[np.ndarray, " n"]:
        """What values at points come to at the nodes by the shape functions of the cells, as of forces.

        A point outside the kept cells belongs to the nearest one; where several are equally near, as in symmetric
        bodies, to each a part, or rounding would decide.
        """
        result = np.zeros(len(self.nodes), np.float32)
        low, edges = self.low.astype(np.float32), self.edges.astype(np.float32)
        _add_at_nodes(points, values, low, edges, self.cells, self.cell_nodes, self._cell_of_box, result)
        return result


@compiled
def _add_at_nodes(
    points: Float32[np.ndarray, "3 k"], values: Float32[np.ndarray, " k"], low: Float32[np.ndarray, "3"],
    edges: Float32[np.ndarray, "3"], cells: Int[np.ndarray, "m 3"], cell_nodes: Int[np.ndarray, "m 8"],
    cell_of_box: Int[np.ndarray, "x y z"], result: Float32[np.ndarray, " n"],
) -> None:  # fmt: skip
    """See `CellGrid.at_nodes`."""
    size_x, size_y, size_z = cell_of_box.shape
    for k in range(len(values)):
        if values[k] == 0.0:
            continue
        x, y = (points[0, k] - low[0]) / edges[0], (points[1, k] - low[1]) / edges[1]
        z = (points[2, k] - low[2]) / edges[2]
        cell = cell_of_box[
            max(min(int(x), size_x - 1), 0), max(min(int(y), size_y - 1), 0), max(min(int(z), size_z - 1), 0)
        ]
        if cell >= 0:
            _add_to_cell(x, y, z, values[k], cells[cell], cell_nodes[cell], result)
            continue
        least, ties = np.float32(np.inf), 0
        for c in range(len(cells)):
            least = min(least, _squared_distance(x, y, z, cells[c]))
        least += np.float32(1e-5) * max(np.float32(1.0), least)
        for c in range(len(cells)):
            if _squared_distance(x, y, z, cells[c]) < least:
                ties += 1
        for c in range(len(cells)):
            if _squared_distance(x, y, z, cells[c]) < least:
                _add_to_cell(x, y, z, values[k] / np.float32(ties), cells[c], cell_nodes[c], result)


@compiled
def _squared_distance(x: np.float32, y: np.float32, z: np.float32, cell: Int[np.ndarray, "3"]) -> np.float32:
    """To the centre of a cell, in edges of it."""
    half = np.float32(0.5)
    x, y, z = np.float32(cell[0]) + half - x, np.float32(cell[1]) + half - y, np.float32(cell[2]) + half - z
    return x * x + y * y + z * z


@compiled
def _add_to_cell(
    x: np.float32, y: np.float32, z: np.float32, value: np.float32, cell: Int[np.ndarray, "3"],
    nodes: Int[np.ndarray, "8"], result: Float32[np.ndarray, " n"],
) -> None:  # fmt: skip
    """Add a value at a place, in edges of a cell, to the corners of the cell."""
    zero, one = np.float32(0.0), np.float32(1.0)
    x = min(max(x - np.float32(cell[0]), zero), one)
    y = min(max(y - np.float32(cell[1]), zero), one)
    z = min(max(z - np.float32(cell[2]), zero), one)
    for a in range(8):
        along_x, along_y, along_z = x if a & 4 else one - x, y if a & 2 else one - y, z if a & 1 else one - z
        result[nodes[a]] += value * along_x * along_y * along_z


def shape_functions(local: Float[np.ndarray, "3 k"]) -> Float[np.ndarray, "8 k"]:
    """Trilinear shape functions at local coordinates in [0, 1]³.

    Source: Hughes, The Finite Element Method (2000), eq. 3.5.2.
    """
    both = np.stack([1.0 - local, local])
    product = both[:, None, None, 0] * both[None, :, None, 1] * both[None, None, :, 2]
    return np.asarray(product.reshape(8, -1))


@compiled
def _keep(held: Octants, sole: SoleWeights, least_sole: np.float32, solid: Box) -> int:
    """Mark the cells that hold enough of the body or of its sole.

    Those connected to the lowest layer across faces are marked with 2, and counted: nothing holds the others.
    """
    for x in range(held.shape[1]):
        for y in range(held.shape[2]):
            for z in range(held.shape[3]):
                fill = np.float32(0.0)
                for part in range(len(held)):
                    fill += held[part, x, y, z]
                solid[x + 1, y + 1, z + 1] = fill >= np.float32(MIN_FILL)
            area = np.float32(0.0)
            for part in range(len(sole)):
                area += sole[part, x, y]
            solid[x + 1, y + 1, 1] |= area >= least_sole
    count, before = 0, -1
    while before != count:
        before = count
        for x in range(1, solid.shape[0] - 1):
            for y in range(1, solid.shape[1] - 1):
                for z in range(1, solid.shape[2] - 1):
                    if solid[x, y, z] == 1:
                        near = solid[x - 1, y, z] | solid[x + 1, y, z] | solid[x, y - 1, z]
                        near |= solid[x, y + 1, z] | solid[x, y, z - 1] | solid[x, y, z + 1]
                        if z == 1 or near & 2:
                            solid[x, y, z] = 2
                            count += 1
    return count


@compiled
def _number(
    kept: Box, count: int, order: tuple[int, int, int], held: Octants
) -> tuple[
    Int[np.ndarray, "x y z"], Int[np.ndarray, "m 3"], Int[np.ndarray, "n 3"], Int[np.ndarray, "m 8"],
    Float32[np.ndarray, "8 m"], Float32[np.ndarray, " m"],
]:  # fmt: skip
    """Number the cells marked with 2 in the order of memory and the nodes by their axes in this order.

    Returns:
        The number of every cell of the box or -1, the cells, the nodes, the nodes of every cell, what its octants hold
        and their sum.
    """
    _, size_x, size_y, size_z = held.shape
    cell_of_box = np.empty((size_x, size_y, size_z), np.int64)
    cells, corners = np.empty((count, 3), np.int64), np.empty((count, 8), np.int64)
    own, fill = np.empty((8, count), np.float32), np.zeros(count, np.float32)
    node_of_box = np.zeros((size_x + 1, size_y + 1, size_z + 1), np.int64)
    m = 0
    for x in range(size_x):
        for y in range(size_y):
            for z in range(size_z):
                cell_of_box[x, y, z] = -1
                if kept[x + 1, y + 1, z + 1] == 2:
                    cell_of_box[x, y, z] = m
                    cells[m, 0], cells[m, 1], cells[m, 2] = x, y, z
                    for q in range(len(own)):
                        own[q, m] = held[q, x, y, z]
                        fill[m] += own[q, m]
                    for a in range(corners.shape[1]):
                        node_of_box[x + (a >> 2), y + (a >> 1 & 1), z + (a & 1)] = 1
                    m += 1
    nodes = np.empty((node_of_box.size, 3), np.int64)
    at, n = np.empty(3, np.int64), 0
    for i in range(node_of_box.shape[order[0]]):
        for j in range(node_of_box.shape[order[1]]):
            for k in range(node_of_box.shape[order[2]]):
                at[order[0]], at[order[1]], at[order[2]] = i, j, k
                if node_of_box[at[0], at[1], at[2]]:
                    node_of_box[at[0], at[1], at[2]] = n
                    nodes[n, 0], nodes[n, 1], nodes[n, 2] = at[0], at[1], at[2]
                    n += 1
    for c in range(count):
        for a in range(corners.shape[1]):
            corners[c, a] = node_of_box[cells[c, 0] + (a >> 2), cells[c, 1] + (a >> 1 & 1), cells[c, 2] + (a & 1)]
    return cell_of_box, cells, nodes[:n], corners, own, fill


@compiled
def _stand(
    cells: Int[np.ndarray, "m 3"], sole: SoleWeights
) -> tuple[Int[np.ndarray, " b"], Float32[np.ndarray, "9 b"]]:
    """The cells that stand on the floor, and their weights."""
    count = 0
    for m in range(len(cells)):
        count += int(cells[m, 2] == 0)
    found, own, b = np.empty(count, np.int64), np.empty((len(sole), count), np.float32), 0
    for m in range(len(cells)):
        if cells[m, 2] == 0:
            found[b] = m
            for part in range(len(sole)):
                own[part, b] = sole[part, cells[m, 0], cells[m, 1]]
            b += 1
    return found, own
