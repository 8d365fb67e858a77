"""Large rotations: every cell is linearly elastic in a frame that turns with it.

Inside the solver arrays are components first and loads last: (3, n, loads) of nodes, (3, 8, m, loads) of corners,
(3, 3, m, loads) of rotations. The inner loops are then as long as there are cells and loads, what is gathered are whole
rows of loads, and the stiffness of a cell multiplies all of them at once.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64, Int

from service.core.prior_assembly import RestFactor
from service.core.prior_element import cell_stiffness, floor_stiffness, mean_gradient
from service.core.prior_grid import CORNERS, CellGrid
from service.core.prior_rotation import exponential, polar_rotation, spin_axis
from service.core.prior_secant import next_place

_LARGEST_ROTATION = 1.3
"""Radians. A cantilever under a dead load turns towards the load, by π/2 at the very most."""

_FARTHEST = 2.0
"""Edges of the body grid. What moves farther has left the grid; loads that would do so are answered at a share."""

Nodal = Float32[np.ndarray, "3 loads n"]
Rows = Float32[np.ndarray, "3 n loads"]
Corners = Float32[np.ndarray, "3 8 m loads"]
Matrices = Float32[np.ndarray, "3 3 k loads"]


class CorotationalSolver:
    """Displacements of one body under any number of loads.

    Args:
        grid: Its cells.
        poisson_ratio: ν in [0, 0.49].

    Source: corotational cells: Müller and Gross, Interactive Virtual Materials (2004). Rotation from the linear
    solution: Huang et al., Interactive shape interpolation through rotation-strain coordinates, TVCG 17 (2011).
    """

    def __init__(self, grid: CellGrid, poisson_ratio: float) -> None:
        self.grid = grid
        self._stiffness = cell_stiffness(grid, poisson_ratio)
        floor = floor_stiffness(grid)
        self._factor = RestFactor(grid, self._stiffness, floor)
        self._gradient = mean_gradient(grid).astype(np.float32)
        self._rest = ((CORNERS - 0.5) * grid.edges).astype(np.float32).T[:, :, None, None]  # (3, 8, 1, 1)
        self._corners = np.ascontiguousarray(grid.cell_nodes.T)  # (8, m)
        self._corners_of_node = _corners_of_node(self._corners, len(grid.nodes))
        shares = np.zeros((len(grid.nodes), len(grid.cells)), np.float32)
        shares[grid.cell_nodes.T, np.arange(len(grid.cells))] = np.maximum(grid.fill, 1e-3)
        self._shares = shares / shares.sum(axis=1, keepdims=True)
        self._sole, self._bed = _bed(grid.cell_nodes[grid.floor_cells], floor)

    def solve(self, force: Nodal, steps: int) -> Nodal:
        """Displacements under nodal forces.

        Args:
            force: In E L².
            steps: 0 gives the linear solution. Otherwise that is unrolled and corrected this many times, see
                `prior_secant`.

        Returns:
            Finite values of at most two edges of the grid, whatever the load: one for which nothing finite comes out is
            answered as none.
        """
        rows = np.ascontiguousarray(force.transpose(0, 2, 1))
        u = self._factor.solve(rows)
        if steps:
            u = self._unrolled(u)
        places: list[Rows] = []
        directions: list[Rows] = []
        for _ in range(steps):
            places.append(u)
            directions.append(self._correction(u, rows))
            u = next_place(places, directions)
        longest = np.abs(u).max(axis=(0, 1))
        u = u * np.minimum(1.0, _FARTHEST / np.maximum(longest, 1e-20)).astype(np.float32)
        u[:, :, ~np.isfinite(longest)] = 0.0
        return np.ascontiguousarray(u.transpose(0, 2, 1))

    def correction(self, u: Nodal, force: Nodal) -> Nodal:
        """About what is missing to balance: the forces left over, by the factor at rest in the frames of the nodes."""
        rows = self._correction(*(np.ascontiguousarray(array.transpose(0, 2, 1)) for array in (u, force)))
        return np.ascontiguousarray(rows.transpose(0, 2, 1))

    def deformation_gradient(self, u: Nodal) -> Float32[np.ndarray, "3 3 loads m"]:
        """F at the centre of every cell."""
        gradient = (self._gradient @ np.take(u, self._corners, axis=2)).transpose(0, 2, 1, 3)
        return np.asarray(gradient + np.eye(3, dtype=np.float32)[:, :, None, None])

    def _correction(self, u: Rows, force: Rows) -> Rows:
        internal, rotation = self._internal_force(u)
        frames = polar_rotation(self._shares @ rotation, steps=2)  # mean rotation of the cells around every node
        return _turn(frames, self._factor.solve(_turn(frames, force - internal, transposed=True)))

    def _internal_force(self, u: Rows) -> tuple[Rows, Matrices]:
        """Forces of the deformed cells and of the bed on the nodes, and the rotations of the cells."""
        corners = np.take(u, self._corners, axis=1)
        gradient = self._displacement_gradient(corners)
        for i in range(3):
            gradient[i, i] += 1.0
        rotation = polar_rotation(gradient, steps=3)
        corners += self._rest
        local = _turn(rotation, corners, transposed=True)
        local -= self._rest
        forces = self._gathered(_turn(rotation, self._cell_forces(local)))
        forces[:, self._sole] += self._bed @ u[:, self._sole]
        return forces, rotation

    def _unrolled(self, u: Rows) -> Rows:
        """The linear solution with the rotations of its cells made finite.

        A cell's displacement without its mean and its infinitesimal rotation ω is turned by exp(ω); the elastic energy
        of what the cells then miss is minimised, with the factor at hand. A load that would turn a cell farther than
        dead loads do is taken at a share: linear elasticity winds a body up without end.
        """
        corners = np.take(u, self._corners, axis=1)
        axis = spin_axis(self._displacement_gradient(corners))  # (3, m, loads)
        largest = np.sqrt((axis * axis).sum(axis=0).max(axis=0))
        share = np.minimum(1.0, _LARGEST_ROTATION / np.maximum(largest, 1e-20)).astype(np.float32)
        axis *= share
        corners *= share
        corners -= corners.mean(axis=1, keepdims=True)
        corners += self._rest
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            corners[i] -= axis[j] * self._rest[k] - axis[k] * self._rest[j]
        target = _turn(exponential(axis), corners)
        target -= self._rest
        return self._factor.solve(self._gathered(self._cell_forces(target)))

    def _displacement_gradient(self, corners: Corners) -> Matrices:
        _, _, m, loads = corners.shape
        return np.asarray((self._gradient @ corners.reshape(3, 8, m * loads)).reshape(3, 3, m, loads))

    def _cell_forces(self, local: Corners) -> Corners:
        _, _, m, loads = local.shape
        forces = self._stiffness @ np.ascontiguousarray(local.transpose(2, 1, 0, 3)).reshape(m, 24, loads)
        return np.ascontiguousarray(forces.reshape(m, 8, 3, loads).transpose(2, 1, 0, 3))

    def _gathered(self, forces: Corners) -> Rows:
        """Sums over the cells around each node."""
        _, _, m, loads = forces.shape
        rows = np.zeros((3, 8 * m + 1, loads), np.float32)
        rows[:, :-1] = forces.reshape(3, 8 * m, loads)
        return np.asarray(np.take(rows, self._corners_of_node, axis=1).sum(axis=1))


def _turn(rotation: Matrices, vectors: Rows | Corners, transposed: bool = False) -> Rows | Corners:
    """R v, or Rᵀ v, of the vectors of nodes or of the corners of cells."""
    columns = rotation if transposed else rotation.swapaxes(0, 1)
    if vectors.ndim == 4:
        columns = columns[:, :, None]
    result = columns[0] * vectors[0]
    part = np.empty_like(result)
    for j in (1, 2):
        result += np.multiply(columns[j], vectors[j], out=part)
    return np.asarray(result)


def _corners_of_node(corners: Int[np.ndarray, "8 m"], nodes: int) -> Int[np.ndarray, "most n"]:
    """Row m·corner + cell of every corner that is this node; the row after the last one where there are fewer."""
    node = corners.ravel()
    order = np.argsort(node, kind="stable")
    count = np.bincount(node, minlength=nodes)
    sorted_node = node[order]
    table = np.full((count.max(), nodes), len(node))
    table[np.arange(len(node)) - (np.cumsum(count) - count)[sorted_node], sorted_node] = order
    return table


def _bed(
    cell_nodes: Int[np.ndarray, "b 8"], stiffness: Float64[np.ndarray, "b 8 8"]
) -> tuple[Int[np.ndarray, " s"], Float32[np.ndarray, "s s"]]:
    """Nodes of the bed under the sole, and its stiffness between them."""
    lower = np.flatnonzero(CORNERS[:, 2] == 0)
    sole, index = np.unique(cell_nodes[:, lower], return_inverse=True)
    index = index.reshape(-1, 4)
    s = len(sole)
    entries = (index[:, :, None] * s + index[:, None, :]).ravel()
    values = stiffness[:, lower][:, :, lower].ravel()
    return sole, np.bincount(entries, values, s * s).reshape(s, s).astype(np.float32)
