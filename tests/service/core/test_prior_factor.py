import numpy as np
import pytest

from service.core.prior_assembly import rest_factor, solve_at_rest
from service.core.prior_cells import Cells
from service.core.prior_element import floor_stiffness
from service.core.prior_factor import PANEL, factorised, substitute
from service.core.prior_grid import CellGrid


def some_body() -> np.ndarray:
    rest = np.zeros((64, 64, 64), bool)
    rest[10:22, 12:50, :40] = True
    rest[10:55, 12:50, 30:40] = True
    return rest


def dense(grid: CellGrid, stiffness: np.ndarray, floor: np.ndarray) -> np.ndarray:
    n = 3 * len(grid.nodes)
    matrix = np.zeros((n, n))
    dof = (3 * grid.cell_nodes[:, :, None] + np.arange(3)).reshape(-1, 24)
    np.add.at(matrix, (dof[:, :, None], dof[:, None, :]), stiffness)
    for axis in range(3):
        own = 3 * grid.cell_nodes[grid.floor_cells, ::2] + axis  # the lower corners
        np.add.at(matrix, (own[:, :, None], own[:, None, :]), floor.transpose(2, 0, 1))
    return matrix


def panels(matrix: np.ndarray, ends: np.ndarray) -> np.ndarray:
    upper = np.zeros((len(ends), PANEL, int((ends - PANEL * np.arange(len(ends))).max())), np.float32)
    for k, end in enumerate(ends):
        upper[k, :, : end - PANEL * k] = matrix[PANEL * k : PANEL * (k + 1), PANEL * k : end]
    return upper


def banded() -> tuple[np.ndarray, np.ndarray]:
    """A matrix whose band widens and narrows, and its ends."""
    ends = np.array([16, 40, 40, 48, 48, 48])
    rng = np.random.default_rng(0)
    matrix = 20.0 * np.eye(48)
    for row in range(48):
        for column in range(row + 1, ends[row // PANEL]):
            matrix[row, column] = matrix[column, row] = rng.normal()
    return matrix, ends


def test_solutions_with_the_factor_are_those_of_the_dense_matrix() -> None:
    matrix, ends = banded()
    right = np.random.default_rng(1).normal(size=(3, 48)).astype(np.float32)
    solution = right.copy()
    substitute(factorised(panels(matrix, ends), ends), solution)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right.T).T, atol=1e-6)


def test_the_factor_is_choleskys_with_inverses_on_the_diagonal() -> None:
    matrix, ends = banded()
    factor = factorised(panels(matrix, ends), ends)
    expected = np.linalg.cholesky(matrix).T
    np.fill_diagonal(expected, 1.0 / np.diag(expected))
    for k, end in enumerate(ends):
        first = PANEL * k
        rows = np.triu(factor.upper[k][:, : end - first])
        np.testing.assert_allclose(rows, expected[first : first + PANEL, first:end], atol=1e-6)


def test_a_matrix_that_is_not_positive_definite_is_refused() -> None:
    matrix, ends = banded()
    matrix[30, 30] = -1.0
    with pytest.raises(np.linalg.LinAlgError):
        factorised(panels(matrix, ends), ends)


@pytest.mark.parametrize("axes", [(0, 1, 2), (1, 0, 2), (2, 1, 0)])
def test_the_factor_of_a_body_solves_its_dense_equations(axes: tuple[int, int, int]) -> None:
    grid = CellGrid.fit(np.ascontiguousarray(some_body().transpose(axes)), 80)
    cells = Cells.of(grid, 0.4)
    force = np.random.default_rng(1).normal(size=(2, 3, len(grid.nodes))).astype(np.float32)
    solution = np.empty_like(force)
    solve_at_rest(rest_factor(cells), force, solution)
    right = force.transpose(2, 1, 0).reshape(-1, 2)
    stiffness = cells.stiffness[:, :, : cells.own].transpose(2, 0, 1)
    expected = np.linalg.solve(dense(grid, stiffness.astype(float), floor_stiffness(grid)), right)
    expected = expected.reshape(-1, 3, 2).transpose(2, 1, 0)
    np.testing.assert_allclose(solution, expected, atol=3e-3 * np.abs(expected).max())


def test_a_body_whose_stiffness_cannot_be_factorised_is_refused() -> None:
    cells = Cells.of(CellGrid.fit(some_body(), 80), 0.4)
    with pytest.raises(np.linalg.LinAlgError, match="positive definite"):
        rest_factor(cells._replace(stiffness=-cells.stiffness))
