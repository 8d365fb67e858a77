"""From the stiffness of the cells to the factor of the body's."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Float64, Int

from service.core.prior_factor import BlockTridiagonal
from service.core.prior_grid import CORNERS, CellGrid

_SHIFTS = (0.0, 1e-5, 1e-3, 1e-2)
"""Relative additions to the diagonal until there is a factor: a sheet one voxel thick is too slender for single
precision, and is held a little stiffer than it is."""


class RestFactor:
    """The factor of a body's stiffness at rest.

    The nodes are taken plane by plane along the axis on which that costs least: a cell couples a plane with the next
    one only, so that the matrix is block tridiagonal.

    Args:
        grid: Cells of the body.
        stiffness: Of every cell, local degree of freedom 3·node + axis.
        floor_stiffness: Of the bed under every floor cell, the same along each axis.

    Raises:
        np.linalg.LinAlgError: The matrix is far from positive definite.
    """

    def __init__(
        self, grid: CellGrid, stiffness: Float32[np.ndarray, "m 24 24"], floor_stiffness: Float64[np.ndarray, "b 8 8"]
    ) -> None:
        counts = [np.bincount(grid.nodes[:, axis]) for axis in range(3)]
        axis = int(np.argmin([float((count.astype(float) ** 3).sum()) for count in counts]))
        # planes without nodes, beside the body or between its feet, are left out
        plane = (np.cumsum(counts[axis] > 0) - 1)[grid.nodes[:, axis]]
        self._order: Int[np.ndarray, " n"] = np.argsort(plane, kind="stable")
        count = counts[axis][counts[axis] > 0]
        place = np.empty(len(plane), np.int64)
        place[self._order] = np.arange(len(plane))
        self._place = place.copy()
        place -= (np.cumsum(count) - count)[plane]
        width = 3 * count
        diagonal_ends = np.cumsum(width * width)
        below_ends = diagonal_ends[-1] + np.cumsum(width[1:] * width[:-1])
        diagonal_start, below_start = diagonal_ends - width * width, below_ends - width[1:] * width[:-1]
        # pairs of local nodes whose block lies on or below the diagonal
        side = CORNERS[:, axis]
        a, b = np.nonzero(side[:, None] >= side[None, :])
        rows, columns = grid.cell_nodes[:, a], grid.cell_nodes[:, b]
        starts = np.where(
            side[a] == side[b], diagonal_start[plane[rows]], np.append(below_start, 0)[plane[rows] - 1]
        )
        stride = width[plane[columns]]
        corner = (starts + 3 * (place[rows] * stride + place[columns])).T
        steps = np.arange(3)
        index = corner[:, :, None, None] + steps[:, None] * stride.T[:, :, None, None] + steps
        entries = stiffness.reshape(-1, 8, 3, 8, 3)[:, a, :, b]  # (pairs, m, 3, 3)
        for i in range(3):
            entries[:, grid.floor_cells, i, i] += floor_stiffness[:, a, b].T
        size = int(width @ width + width[1:] @ width[:-1])
        flat = np.bincount(index.ravel(), weights=entries.ravel(), minlength=size).astype(np.float32)
        diagonal = [
            flat[start : start + n * n].reshape(n, n) for start, n in zip(diagonal_start, width, strict=True)
        ]
        below = [
            flat[start : start + n * m].reshape(n, m)
            for start, n, m in zip(below_start, width[1:], width[:-1], strict=True)
        ]
        self._factor = _factorised(diagonal, below)

    def solve(self, force: Float32[np.ndarray, "3 n loads"]) -> Float32[np.ndarray, "3 n loads"]:
        """Displacements of the nodes by linear elasticity."""
        _, n, loads = force.shape
        right = np.take(force.swapaxes(0, 1), self._order, axis=0).reshape(3 * n, loads)
        solution = self._factor.solve(right).reshape(n, 3, loads)
        return np.ascontiguousarray(np.take(solution, self._place, axis=0).swapaxes(0, 1))


def _factorised(
    diagonal: Sequence[Float32[np.ndarray, "_ _"]], below: Sequence[Float32[np.ndarray, "_ _"]]
) -> BlockTridiagonal:
    for shift in _SHIFTS:
        for block in diagonal if shift else ():
            block[np.diag_indices(len(block))] *= np.float32(1.0 + shift)
        try:
            return BlockTridiagonal(diagonal, below)
        except np.linalg.LinAlgError:
            continue
    raise np.linalg.LinAlgError("the stiffness matrix is not positive definite, nor stiffened by a hundredth")
