import numpy as np
import pytest

from service.core.prior_element import FILL_POWER, Element, rest_stiffness
from service.core.prior_grid import CORNERS, CellGrid, shape_functions


def of(grid: CellGrid, poisson_ratio: float) -> np.ndarray:
    """Stiffness of every cell, (m, 24, 24)."""
    element = Element.of(grid, poisson_ratio, len(grid.cells))
    return np.asarray(rest_stiffness(element).transpose(2, 0, 1), float)


def full() -> CellGrid:
    rest = np.zeros((64, 64, 64), bool)
    rest[8:40, 16:48, :48] = True
    return CellGrid.fit(rest, 60)


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_a_rigid_motion_costs_nothing_and_a_constant_strain_its_energy(poisson_ratio: float) -> None:
    """Rotations are infinitesimal here; μ ε : ε + λ/2 (tr ε)² times the volume for an affine displacement."""
    grid = full()
    stiffness = of(grid, poisson_ratio)
    shear, bulk = 0.5 / (1 + poisson_ratio), poisson_ratio / ((1 + poisson_ratio) * (1 - 2 * poisson_ratio))
    for gradient in (np.array([[0, -1, 2], [1, 0, -3], [-2, 3, 0.0]]), np.arange(9.0).reshape(3, 3) / 9):
        u = (grid.node_positions @ gradient.T + 0.5)[grid.cell_nodes].reshape(-1, 24)
        strain = 0.5 * (gradient + gradient.T)
        expected = (shear * (strain**2).sum() + 0.5 * bulk * np.trace(strain) ** 2) * 0.5 * 0.5 * 0.75
        energy = 0.5 * np.einsum("ma,mab,mb->", u, stiffness, u)
        assert energy == pytest.approx(expected, rel=2e-3, abs=2e-3 * max(shear, bulk))


@pytest.mark.parametrize("poisson_ratio", [0.0, 1 / 3, 0.49])
def test_one_full_cell_in_pure_bending_has_three_shear_moduli(poisson_ratio: float) -> None:
    """u_x = x z at the corners, curvature 1: (2μ + μ) I/2 over the length, as the mean volume stays and the shear that
    a trilinear cell shows counts. At ν = ⅓ that is a plate's E/(1 − ν²)."""
    rest = np.zeros((64, 64, 64), bool)
    rest[:32, :32, :32] = True
    stiffness = of(CellGrid.fit(rest, 1), poisson_ratio)[0]
    place = CORNERS * 0.5 - 0.25
    u = np.zeros((8, 3))
    u[:, 0] = place[:, 0] * place[:, 2]
    energy = 0.5 * u.ravel() @ stiffness @ u.ravel()
    shear = 0.5 / (1 + poisson_ratio)
    assert energy == pytest.approx(0.5 * 3 * shear * 0.5**4 / 12 * 0.5, rel=1e-3)
    if poisson_ratio == 1 / 3:
        assert energy == pytest.approx(0.5 / (1 - poisson_ratio**2) * 0.5**4 / 12 * 0.5, rel=1e-3)


def test_a_bending_cell_does_not_lock_where_the_material_hardly_gives_volume() -> None:
    """λ is 16 times E at ν = 0.49, and none of it is in the energy of bending."""
    test_one_full_cell_in_pure_bending_has_three_shear_moduli(0.49)


def test_a_cell_that_is_part_full_is_as_stiff_as_a_power_of_its_fill() -> None:
    """Stretched along the cut, half a cell stores its share of the energy to the power of 1.2, and next to nothing
    besides."""
    rest = np.zeros((64, 64, 64), bool)
    rest[:32, :32, :32] = True
    rest[0, :32, :16] = True
    whole = of(CellGrid.fit(rest, 1), 0.0)[0]
    grid = CellGrid.fit(rest, 1)
    half = Element.of(grid, 0.0, 1)
    half = half._replace(weights=half.weights * np.repeat([1, 0], 4)[:, None].astype(np.float32))
    u = np.zeros((8, 3))
    u[:, 2] = CORNERS[:, 2]
    energy = [0.5 * u.ravel() @ k @ u.ravel() for k in (whole, rest_stiffness(half)[:, :, 0])]
    assert energy[1] / energy[0] == pytest.approx(0.5, rel=1e-3)
    cut = np.zeros((64, 64, 64), bool)
    cut[:32, :32, :32] = np.indices((32, 32, 32))[0] < 16
    cut[31, 31, 31] = True  # keeps the box
    grid = CellGrid.fit(cut, 1)
    stored = 0.5 * u.ravel() @ of(grid, 0.0)[0] @ u.ravel()
    assert stored / energy[0] == pytest.approx(0.5**FILL_POWER, rel=0.01)


def test_shape_functions_sum_to_one_and_reproduce_positions() -> None:
    points = np.random.default_rng(0).random((20, 3))
    shape = shape_functions(points.T).T
    np.testing.assert_allclose(shape.sum(axis=1), 1.0)
    np.testing.assert_allclose(shape @ CORNERS, points, atol=1e-12)
