from itertools import pairwise

import numpy as np
import pytest

from service.core.prior_assembly import RestFactor
from service.core.prior_element import cell_stiffness, elastic_moduli, floor_stiffness
from service.core.prior_factor import BlockTridiagonal, invert_spd
from service.core.prior_grid import POINTS_27, CellGrid, shape_functions


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
        own = 3 * grid.cell_nodes[grid.floor_cells] + axis
        np.add.at(matrix, (own[:, :, None], own[:, None, :]), floor)
    return matrix


@pytest.mark.parametrize("n", [1, 5, 36, 37, 100, 171])
def test_the_inverse_by_halves_is_the_inverse(n: int) -> None:
    factor = np.random.default_rng(n).normal(size=(n, n))
    matrix = (factor @ factor.T + n * np.eye(n)).astype(np.float32)
    np.testing.assert_allclose(invert_spd(matrix) @ matrix, np.eye(n), atol=2e-5)


def test_a_matrix_that_is_not_positive_definite_is_refused() -> None:
    with pytest.raises(np.linalg.LinAlgError):
        invert_spd(-np.eye(4, dtype=np.float32))


def test_block_tridiagonal_solutions_are_those_of_the_dense_matrix() -> None:
    rng = np.random.default_rng(0)
    sizes = [7, 40, 3, 12]
    ends = np.cumsum(sizes)
    below = [rng.normal(size=(b, a)).astype(np.float32) for a, b in pairwise(sizes)]
    matrix = 40.0 * np.eye(ends[-1], dtype=np.float32)
    for block, row, middle in zip(below, ends[1:], ends[:-1], strict=True):
        rows, columns = slice(middle, row), slice(middle - block.shape[1], middle)
        matrix[rows, columns], matrix[columns, rows] = block, block.T
    diagonal = [matrix[end - size : end, end - size : end] for size, end in zip(sizes, ends, strict=True)]
    right = rng.normal(size=(ends[-1], 2)).astype(np.float32)
    solution = BlockTridiagonal(diagonal, below).solve(right)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right), rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("axes", [(0, 1, 2), (1, 0, 2)])
def test_the_factor_of_a_body_solves_its_dense_equations(axes: tuple[int, int, int]) -> None:
    grid = CellGrid.fit(np.ascontiguousarray(some_body().transpose(axes)), 80)
    stiffness, floor = cell_stiffness(grid, 0.4), floor_stiffness(grid)
    force = np.random.default_rng(1).normal(size=(3, len(grid.nodes), 2)).astype(np.float32)
    solution = RestFactor(grid, stiffness, floor).solve(force)
    right = force.transpose(1, 0, 2).reshape(-1, 2)
    expected = np.linalg.solve(dense(grid, stiffness.astype(float), floor), right)
    expected = expected.reshape(-1, 3, 2).transpose(1, 0, 2)
    np.testing.assert_allclose(solution, expected, atol=3e-3 * np.abs(expected).max())


def test_a_rigid_motion_costs_nothing_and_a_constant_strain_its_energy() -> None:
    """Rotations are infinitesimal here; ½ ε : C ε times the volume for an affine displacement of full cells."""
    rest = np.zeros((64, 64, 64), bool)
    rest[8:40, 16:48, :48] = True
    grid = CellGrid.fit(rest, 60)
    stiffness = cell_stiffness(grid, 0.3)
    positions = grid.low + grid.nodes * grid.edges
    for gradient in (np.array([[0, -1, 2], [1, 0, -3], [-2, 3, 0.0]]), np.arange(9.0).reshape(3, 3) / 9):
        u = (positions @ gradient.T + 0.5)[grid.cell_nodes].reshape(-1, 24)
        energy = 0.5 * np.einsum("ma,mab,mb->", u, stiffness, u)
        flat = gradient.ravel()
        assert energy == pytest.approx(
            0.5 * flat @ elastic_moduli(0.3) @ flat * 0.5 * 0.5 * 0.75, rel=2e-3, abs=2e-4
        )


def test_one_full_cell_in_pure_bending_has_the_energy_of_a_beam() -> None:
    """u_x = x z at the corners, curvature 1: E I a/2 of a plate, whose E is E/(1 − ν²)."""
    rest = np.zeros((64, 64, 64), bool)
    rest[:32, :32, :32] = True
    grid = CellGrid.fit(rest, 1)
    stiffness = cell_stiffness(grid, 0.3)[0]
    place = np.array([[a >> 2 & 1, a >> 1 & 1, a & 1] for a in range(8)]) * 0.5 - 0.25
    u = np.zeros((8, 3))
    u[:, 0] = place[:, 0] * place[:, 2]
    energy = 0.5 * u.ravel() @ stiffness @ u.ravel()
    # E/(1 − ν²) I κ²/2 a over the width: the corners hold the cell flat across
    assert energy == pytest.approx(0.5 / (1 - 0.3**2) * 0.5**4 / 12 * 0.5, rel=0.01)


def test_shape_functions_sum_to_one_and_reproduce_positions() -> None:
    shape = shape_functions(POINTS_27.T).T
    corners = np.array([[a >> 2 & 1, a >> 1 & 1, a & 1] for a in range(8)])
    np.testing.assert_allclose(shape.sum(axis=1), 1.0)
    np.testing.assert_allclose(shape @ corners, POINTS_27, atol=1e-12)
