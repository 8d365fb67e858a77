"""The few hexahedral cells that the coarse elastic solve knows a body by, and how much material each holds.

The cells fill the body's bounding box rather than the cube, so that all of them are spent on the body; they are about
as wide as high. Everything is in edges of the body grid, z up.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int, UInt64

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.compiled import compiled
from service.core.extent import filled_range

CORNERS: Int[np.ndarray, "8 3"] = np.array([[a >> 2 & 1, a >> 1 & 1, a & 1] for a in range(8)])
"""Corner (dx, dy, dz) of local node a = 4·dx + 2·dy + dz."""

GAUSS_3: Float64[np.ndarray, "3"] = 0.5 + np.sqrt(0.15) * np.array([-1.0, 0.0, 1.0])
"""Abscissae in [0, 1] of the Gauss rule of three points."""

POINTS_27: Float64[np.ndarray, "27 3"] = np.stack(np.meshgrid(GAUSS_3, GAUSS_3, GAUSS_3, indexing="ij"), -1).reshape(
    -1, 3
)
"""Local coordinates of the 3×3×3 Gauss points of a cell."""

MIN_FILL = 0.01
"""Cells holding less material than this are left out."""


@dataclass(frozen=True, eq=False)
class CellGrid:
    """Cells with material that stand on the floor of the body, and their nodes.

    Attributes:
        low: Lowest corner of the box.
        edges: Edges of a cell along x, y, z.
        shape: Cells along x, y, z.
        cells: Index of every kept cell in the box.
        weights: Quadrature weight of each of the 27 Gauss points, in volumes of a cell. They integrate polynomials up
            to the second degree in each coordinate over the material of the cell exactly; some may be negative.
        fill: Part of each cell that holds material.
        nodes: Index of every node in the box, from 0 to `shape`; those of a cell have numbers that lie near.
        cell_nodes: Node number of each corner of each cell, corner 4·dx + 2·dy + dz.
        floor_cells: Which cells stand on the floor.
        floor_weights: As `weights`, of the 3×3 Gauss points of their lower faces, over the sole of the body.
    """

    low: Float64[np.ndarray, "3"]
    edges: Float64[np.ndarray, "3"]
    shape: tuple[int, int, int]
    cells: Int[np.ndarray, "m 3"]
    weights: Float64[np.ndarray, "27 m"]
    fill: Float64[np.ndarray, " m"]
    nodes: Int[np.ndarray, "n 3"]
    cell_nodes: Int[np.ndarray, "m 8"]
    floor_cells: Int[np.ndarray, " b"]
    floor_weights: Float64[np.ndarray, "9 b"]
    _cell_of_box: Int[np.ndarray, "x y z"]

    @classmethod
    def fit(cls, occupancy: Occupancy, cells: int) -> CellGrid:
        """Lay about `cells` cells over the bounding box of a body.

        Raises:
            ValueError: The body is empty.
        """
        filled = filled_range(occupancy)
        if filled is None:
            raise ValueError("an empty body has no elastic solution: the occupancy holds no voxel")
        low_index, high_index = map(np.array, filled)
        low, high = low_index / GRID_SIZE, high_index / GRID_SIZE
        extent = high - low
        width = (extent.prod() / cells) ** (1.0 / 3.0)
        shape = np.maximum(np.round(extent / width), 1).astype(int)
        box = occupancy[tuple(slice(a, b) for a, b in zip(low_index, high_index, strict=True))].astype(np.float32)
        x, y, z = (_moments(int(n), int(v)) for n, v in zip(shape, box.shape, strict=True))
        nx, ny, nz = (int(n) for n in shape)
        # box[x, y, z] times one table an axis, the longest sums first
        along_z = box.reshape(-1, box.shape[2]) @ z.T
        along_x = x @ along_z.reshape(box.shape[0], -1)
        moments = np.matmul(y, along_x.reshape(3 * nx, box.shape[1], 3 * nz))
        weights = moments.reshape(nx, 3, ny, 3, nz, 3).transpose(1, 3, 5, 0, 2, 4).reshape(27, nx, ny, nz)
        floor = (x @ box[:, :, 0] @ y.T).reshape(nx, 3, ny, 3).transpose(1, 3, 0, 2).reshape(9, nx, ny)
        solid = weights.sum(axis=0) >= MIN_FILL
        solid[:, :, 0] |= floor.sum(axis=0) >= MIN_FILL
        kept = _standing(solid)
        if not kept.any():  # a body that touches the floor with a few voxels only
            solid[:, :, 0] |= floor.sum(axis=0) > 1e-6
            kept = _standing(solid)
        active = np.argwhere(kept)
        floor_cells = np.flatnonzero(active[:, 2] == 0)
        used = np.zeros((nx + 1, ny + 1, nz + 1), bool)
        for dx, dy, dz in CORNERS:
            used[dx : nx + dx, dy : ny + dy, dz : nz + dz] |= kept
        node_of_box = np.full(used.shape, -1)
        # numbered plane by plane along the longest axis, row by row along the next one: nodes of a cell are then near
        order = np.argsort([-nx, -ny, -nz], kind="stable")
        places = np.nonzero(used.transpose(order))
        node_of_box.transpose(order)[places] = np.arange(len(places[0]))
        nodes = np.stack([places[list(order).index(axis)] for axis in range(3)], axis=1)
        corners = active[:, None, :] + CORNERS
        cell_of_box = np.full(kept.shape, -1)
        cell_of_box[kept] = np.arange(len(active))
        chosen = weights[:, kept].astype(np.float64)
        return cls(
            low=low, edges=extent / shape, shape=(nx, ny, nz), cells=active, weights=chosen, fill=chosen.sum(axis=0),
            nodes=nodes, cell_nodes=node_of_box[corners[..., 0], corners[..., 1], corners[..., 2]],
            floor_cells=floor_cells,
            floor_weights=floor[:, active[floor_cells, 0], active[floor_cells, 1]].astype(np.float64),
            _cell_of_box=cell_of_box,
        )  # fmt: skip

    @property
    def voxel_bounds(self) -> tuple[Int[np.ndarray, "3"], Int[np.ndarray, "3"]]:
        """First voxel of the box along each axis, and one past its last."""
        high = self.low + self.edges * self.shape
        return np.rint(self.low * GRID_SIZE).astype(int), np.rint(high * GRID_SIZE).astype(int)

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
        for c in range(len(cells)):
            if _squared_distance(x, y, z, cells[c]) < least + np.float32(1e-5):
                ties += 1
        for c in range(len(cells)):
            if _squared_distance(x, y, z, cells[c]) < least + np.float32(1e-5):
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


def column_words(occupancy: Occupancy) -> UInt64[np.ndarray, "x y"]:
    """The voxels of every column along z as the bits of a word, the lowest first."""
    return np.packbits(np.ascontiguousarray(occupancy), axis=2, bitorder="little").view("<u8")[:, :, 0]


@lru_cache(maxsize=512)
def _moments(cells: int, voxels: int) -> Float32[np.ndarray, "points voxels"]:
    """Integrals of the Lagrange polynomials of the Gauss points over the part of each voxel in each cell.

    Row 3·cell + point; `cells` cells over `voxels` voxels. Applied along each axis they fit quadrature weights to the
    moments of the material (moment fitting: Müller, Kummer and Oberlack, IJNME 96 (2013)).
    """
    face = np.arange(voxels + 1) * (cells / voxels)
    low = np.clip(face[:-1] - np.arange(cells)[:, None], 0.0, 1.0)
    high = np.clip(face[1:] - np.arange(cells)[:, None], 0.0, 1.0)
    table = np.empty((cells, 3, voxels))
    for point in range(3):
        others = np.delete(GAUSS_3, point)
        polynomial = np.poly1d(others, r=True) / np.prod(GAUSS_3[point] - others)
        integral = polynomial.integ()
        table[:, point] = integral(high) - integral(low)
    return table.reshape(3 * cells, voxels).astype(np.float32)


def _standing(solid: Bool[np.ndarray, "x y z"]) -> Bool[np.ndarray, "x y z"]:
    """Cells connected to the lowest layer across faces: nothing holds the others."""
    reached = np.zeros_like(solid)
    reached[:, :, 0] = solid[:, :, 0]
    count = 0
    while count != (count := int(reached.sum())):
        grown = reached.copy()
        grown[1:] |= reached[:-1]
        grown[:-1] |= reached[1:]
        grown[:, 1:] |= reached[:, :-1]
        grown[:, :-1] |= reached[:, 1:]
        grown[:, :, 1:] |= reached[:, :, :-1]
        grown[:, :, :-1] |= reached[:, :, 1:]
        reached = grown & solid
    return reached
