"""Large rotations: every cell is linearly elastic in a frame that turns with it.

All arrays are components first and cells or nodes last, (…, loads, nodes), so that the inner loops of NumPy are long.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from service.core.prior_assembly import RestFactor
from service.core.prior_element import cell_stiffness, floor_stiffness, mean_gradient
from service.core.prior_grid import CORNERS, CellGrid
from service.core.prior_rotation import exponential, polar_rotation, spin_axis

_LONGEST_STEP = 0.2
"""No correction is longer, in edges of the body grid."""

_DEPTH = 2
"""Earlier places that a step looks back on."""

_LARGEST_SHARE = 2.0
"""Of a move between earlier places that is taken back or repeated."""

_DAMPING = 1e-4
"""Of the least squares of the step, of their mean diagonal."""

_LARGEST_ROTATION = 1.3
"""Radians. A cantilever under a dead load turns towards the load, by π/2 at the very most."""

Nodal = Float32[np.ndarray, "3 loads n"]
OfCells = Float32[np.ndarray, "3 3 loads m"]


class CorotationalSolver:
    """Displacements of one body under any number of loads.

    Args:
        grid: Its cells.
        poisson_ratio: ν in [0, 0.49].

    Source: corotational cells: Müller and Gross, Interactive Virtual Materials (2004). Rotation from the linear
    solution: Huang et al., Interactive shape interpolation through rotation-strain coordinates, TVCG 17 (2011). Secant
    step: Anderson, J. ACM 12 (1965), of depth two; its length: Barzilai and Borwein, IMA J. Numer. Anal. 8 (1988).
    """

    def __init__(self, grid: CellGrid, poisson_ratio: float) -> None:
        self.grid = grid
        self._stiffness = cell_stiffness(grid, poisson_ratio)
        floor = floor_stiffness(grid)
        self._factor = RestFactor(grid, self._stiffness, floor)
        m, n = len(grid.cells), len(grid.nodes)
        self._corners = np.ascontiguousarray(grid.cell_nodes.T)  # (8, m)
        self._scatter = np.zeros((8 * m, n), np.float32)
        self._scatter[np.arange(8 * m), self._corners.ravel()] = 1.0
        shares = np.zeros((m, n), np.float32)
        shares[np.arange(m)[:, None], grid.cell_nodes] = np.maximum(grid.fill, 1e-3)[:, None]
        self._shares = shares / shares.sum(axis=0)
        self._gradient = mean_gradient(grid).astype(np.float32)
        self._rest = ((CORNERS - 0.5) * grid.edges).astype(np.float32).T[:, None, :, None]  # (3, 1, 8, 1)
        nodes = grid.cell_nodes[grid.floor_cells]
        index = nodes[:, :, None] * n + nodes[:, None, :]
        self._bed = np.bincount(index.ravel(), weights=floor.ravel(), minlength=n * n).reshape(n, n).astype(np.float32)

    def solve(self, force: Nodal, steps: int) -> Nodal:
        """Displacements under nodal forces.

        Args:
            force: In E L².
            steps: 0 gives the linear solution. Otherwise that is unrolled and corrected this many times, each
                correction as long as the last one proved right to be.
        """
        u = self._factor.solve(force)
        if steps == 0:
            return u
        u = self._unrolled(u)
        places: list[Nodal] = []
        directions: list[Nodal] = []
        for _ in range(steps):
            places = [*places[-_DEPTH:], u]
            directions = [*directions[-_DEPTH:], self.correction(u, force)]
            u = _next_place(places, directions)
        return u

    def correction(self, u: Nodal, force: Nodal) -> Nodal:
        """About what is missing to balance: the forces left over, by the factor at rest in the frames of the nodes."""
        internal, rotation = self.internal_force(u)
        frames = self._node_frames(rotation)
        return _turn(frames, self._factor.solve(_turn_back(frames, force - internal)))

    def internal_force(self, u: Nodal) -> tuple[Nodal, OfCells]:
        """Forces of the deformed cells and of the bed on the nodes, and the rotations of the cells."""
        corners = u[:, :, self._corners]
        gradient = self._displacement_gradient(corners)
        for i in range(3):
            gradient[i, i] += 1.0
        rotation = polar_rotation(gradient)
        local = _turn_back(rotation[:, :, :, None], corners + self._rest) - self._rest
        forces = _turn(rotation[:, :, :, None], self._cell_forces(local))
        return self._gathered(forces) + u @ self._bed, rotation

    def deformation_gradient(self, u: Nodal) -> OfCells:
        """F at the centre of every cell."""
        gradient = self._displacement_gradient(u[:, :, self._corners])
        for i in range(3):
            gradient[i, i] += 1.0
        return gradient

    def _unrolled(self, u: Nodal) -> Nodal:
        """The linear solution with the rotations of its cells made finite.

        A cell's displacement without its mean and its infinitesimal rotation ω is turned by exp(ω); the elastic energy
        of what the cells then miss is minimised, with the factor at hand. A load that would turn a cell farther than
        dead loads do is taken at a share: linear elasticity winds a body up without end.
        """
        corners = u[:, :, self._corners]
        axis = spin_axis(self._displacement_gradient(corners))[:, :, None]
        largest = np.sqrt((axis**2).sum(axis=0).max(axis=2))
        share = np.minimum(1.0, _LARGEST_ROTATION / np.maximum(largest, 1e-20))[:, :, None].astype(np.float32)
        corners, axis = corners * share, axis * share
        local = corners - corners.mean(axis=2, keepdims=True) + self._rest
        for i in range(3):
            j, k = (i + 1) % 3, (i + 2) % 3
            local[i] -= axis[j] * self._rest[k] - axis[k] * self._rest[j]
        target = _turn(exponential(axis), local) - self._rest
        return self._factor.solve(self._gathered(self._cell_forces(target)))

    def _displacement_gradient(self, corners: Float32[np.ndarray, "3 loads 8 m"]) -> OfCells:
        return np.ascontiguousarray((self._gradient @ corners).transpose(0, 2, 1, 3))

    def _cell_forces(self, local: Float32[np.ndarray, "3 loads 8 m"]) -> Float32[np.ndarray, "3 loads 8 m"]:
        _, loads, _, m = local.shape
        forces = self._stiffness @ np.ascontiguousarray(local.transpose(3, 2, 0, 1)).reshape(m, 24, loads)
        return np.asarray(forces.reshape(m, 8, 3, loads).transpose(2, 3, 1, 0))

    def _gathered(self, forces: Float32[np.ndarray, "3 loads 8 m"]) -> Nodal:
        _, loads, _, m = forces.shape
        result: Nodal = (forces.reshape(3 * loads, 8 * m) @ self._scatter).reshape(3, loads, -1)
        return result

    def _node_frames(self, rotation: OfCells) -> Float32[np.ndarray, "3 3 loads n"]:
        """Mean rotation of the cells around every node."""
        return polar_rotation(rotation @ self._shares)


def _next_place(places: Sequence[Nodal], directions: Sequence[Nodal]) -> Nodal:
    """From the places passed and the corrections that seemed right there to the next one, each load for itself.

    The combination of corrections that is smallest, by the differences to the earlier ones, is followed for as long as
    the last correction proved right to be.
    """
    u, direction = places[-1], directions[-1]
    middle, rest = u, direction
    if len(places) > 1:
        moves = [u - place for place in reversed(places[:-1])]
        changes = np.stack([direction - other for other in reversed(directions[:-1])])  # (depth, 3, loads, n)
        products = np.einsum("aclk,bclk->lab", changes, np.concatenate([changes, direction[None]]))
        normal = products[:, :, :-1].astype(np.float64)
        spread = np.trace(normal, axis1=1, axis2=2) / len(moves)
        normal += (_DAMPING * spread + 1e-20)[:, None, None] * np.eye(len(moves))
        share = np.linalg.solve(normal, products[:, :, -1:].astype(np.float64))[:, :, 0]
        share = np.clip(share, -_LARGEST_SHARE, _LARGEST_SHARE).astype(np.float32)
        squared = np.maximum(products[:, 0, 0], 1e-20)
        length = np.minimum(1.0, np.sqrt((moves[0] ** 2).sum(axis=(0, 2)) / squared))[:, None].astype(np.float32)
        for k, move in enumerate(moves):
            middle = middle - share[:, k, None] * move
            rest = rest - share[:, k, None] * changes[k]
        rest = length * rest
    longest = np.maximum(np.abs(rest).max(axis=(0, 2)), 1e-20)
    return np.asarray(middle + rest * np.minimum(1.0, _LONGEST_STEP / longest)[:, None].astype(np.float32))


def _turn(
    rotation: Float32[np.ndarray, "3 3 ..."], vectors: Float32[np.ndarray, "3 ..."]
) -> Float32[np.ndarray, "3 ..."]:
    """R v; dimensions of size one are stretched."""
    return np.asarray((rotation * vectors).sum(axis=1))


def _turn_back(
    rotation: Float32[np.ndarray, "3 3 ..."], vectors: Float32[np.ndarray, "3 ..."]
) -> Float32[np.ndarray, "3 ..."]:
    """Rᵀ v."""
    return np.asarray((rotation * vectors[:, None]).sum(axis=0))
