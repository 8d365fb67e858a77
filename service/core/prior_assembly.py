"""From the stiffness of the cells to the factor of the body's."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32, Float64, Int

from service.core.prior_factor import BlockTridiagonal
from service.core.prior_grid import CORNERS, CellGrid


class RestFactor:
    """The factor of a body's stiffness at rest.

    The nodes are taken plane by plane along the axis on which that costs least: a cell couples a plane with the next
    one only, so that the matrix is block tridiagonal.

    Args:
        grid: Cells of the body.
        stiffness: Of every cell, local degree of freedom 3·node + axis.
        floor_stiffness: Of the bed under every floor cell, the same along each axis.
    """

    def __init__(
        self, grid: CellGrid, stiffness: Float32[np.ndarray, "m 24 24"], floor_stiffness: Float64[np.ndarray, "b 8 8"]
    ) -> None:
        counts = [np.bincount(grid.nodes[:, axis]) for axis in range(3)]
        axis = int(np.argmin([float((count.astype(float) ** 3).sum()) for count in counts]))
        plane = grid.nodes[:, axis]
        self.order: Int[np.ndarray, " n"] = np.argsort(plane, kind="stable")
        count = counts[axis]
        place = np.empty(len(plane), np.int64)
        place[self.order] = np.arange(len(plane))
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
        self._factor = BlockTridiagonal(diagonal, below)

    def solve(self, force: Float32[np.ndarray, "3 loads n"]) -> Float32[np.ndarray, "3 loads n"]:
        """Displacements of the nodes by linear elasticity."""
        _, loads, n = force.shape
        right = force[:, :, self.order].transpose(2, 0, 1).reshape(3 * n, loads)
        result = np.empty_like(force)
        result[:, :, self.order] = self._factor.solve(right).reshape(n, 3, loads).transpose(1, 2, 0)
        return result
