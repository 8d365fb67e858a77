"""Which cell of a grid holds a point, or carries a point of the surface."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int

from service.core.compiled import compiled

DEPTHS = (1e-4, 0.02, 0.1, 0.3)
"""How far below the surface, in cell edges, the cell that carries a surface point is looked for: a hair, so that a face
on the border of two cells belongs to the one with the material, or deeper where that cell holds too little of it."""


def locate(
    points: Float64[np.ndarray, "k 3"], cell_of_grid: Int[np.ndarray, "n n n"]
) -> tuple[Int[np.ndarray, " k"], Float64[np.ndarray, "k 3"]]:
    """Cell of each point of the unit cube, −1 where there is none, and its local coordinates in [0, 1]³."""
    return _first(points, np.zeros_like(points), cell_of_grid, np.zeros(1))


def settle(
    points: Float64[np.ndarray, "k 3"], normals: Float64[np.ndarray, "k 3"], cell_of_grid: Int[np.ndarray, "n n n"]
) -> tuple[Int[np.ndarray, " k"], Float64[np.ndarray, "k 3"]]:
    """As `locate`, for points on the surface with outward normals, each moved inwards until there is a cell."""
    return _first(points, normals, cell_of_grid, np.array(DEPTHS))


def _first(
    points: Float64[np.ndarray, "k 3"],
    normals: Float64[np.ndarray, "k 3"],
    cell_of_grid: Int[np.ndarray, "n n n"],
    depths: Float64[np.ndarray, " d"],
) -> tuple[Int[np.ndarray, " k"], Float64[np.ndarray, "k 3"]]:
    cell, local = np.full(len(points), -1), np.zeros((len(points), 3))
    _find(np.ascontiguousarray(points), np.ascontiguousarray(normals), cell_of_grid, depths, cell, local)
    return cell, local


@compiled
def _find(
    points: Float64[np.ndarray, "k 3"],
    normals: Float64[np.ndarray, "k 3"],
    cell_of_grid: Int[np.ndarray, "n n n"],
    depths: Float64[np.ndarray, " d"],
    cell: Int[np.ndarray, " k"],
    local: Float64[np.ndarray, "k 3"],
) -> None:
    """Write the first cell that holds a point, moved inwards by each depth in turn, and the place in it."""
    n = cell_of_grid.shape[0]
    for row in range(len(points)):
        for index in range(len(depths)):
            x = points[row, 0] * n - depths[index] * normals[row, 0]
            y = points[row, 1] * n - depths[index] * normals[row, 1]
            z = points[row, 2] * n - depths[index] * normals[row, 2]
            if not (min(x, y, z) >= 0.0 and max(x, y, z) <= n):
                continue
            i, j, k = min(int(x), n - 1), min(int(y), n - 1), min(int(z), n - 1)
            if cell_of_grid[i, j, k] >= 0:
                cell[row] = cell_of_grid[i, j, k]
                local[row, 0], local[row, 1], local[row, 2] = x - i, y - j, z - k
                break
