import numpy as np
import pytest

from service.core.prior_assembly import rest_factor, solve_at_rest
from service.core.prior_cells import Cells
from service.core.prior_element import floor_stiffness
from service.core.prior_grid import CellGrid
from service.inference.spare_cores import SpareCores


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


def test_a_factor_found_by_two_threads_is_that_found_by_one() -> None:
    cells = Cells.of(CellGrid.fit(some_body(), 300), 0.4)
    alone = rest_factor(cells)
    assert alone.before and alone.after
    shared = rest_factor(cells, SpareCores(1).spread)
    for band, other in ((alone.forward, shared.forward), (alone.backward, shared.backward)):
        np.testing.assert_array_equal(band.upper, other.upper)
