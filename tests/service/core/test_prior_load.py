import numpy as np
import pytest

from service.core.prior_grid import CellGrid
from service.core.prior_load import Surface, nodal_forces


def box() -> np.ndarray:
    rest = np.zeros((64, 64, 64), bool)
    rest[16:48, 20:44, :40] = True
    return rest


def push(contact: tuple[float, float, float], radius: float = 0.15) -> np.ndarray:
    return np.array([*contact, 0.6, 0.0, -0.8, -3.0, 0.3, radius], np.float32)


def centre(grid: CellGrid, force: np.ndarray) -> np.ndarray:
    """Where the resultant acts."""
    weight = force[2] / force[2].sum()
    return np.asarray(weight @ grid.node_positions)


def test_nodal_forces_sum_to_the_load() -> None:
    rest = box()
    grid = CellGrid.fit(rest, 125)
    loads = [push((0.5, 0.5, 0.625)), push((0.25, 0.4, 0.3)), push((0.75, 0.6, 0.02), 0.2)]
    forces = nodal_forces(grid, Surface.of(grid, rest), loads)
    for i in range(3):
        np.testing.assert_allclose(forces[:, i].sum(axis=1), [6e-4, 0.0, -8e-4], atol=1e-9)


@pytest.mark.parametrize("contact", [(0.5, 0.5, 0.625), (0.25, 0.5, 0.3), (0.5, 0.6875, 0.3)])
def test_a_patch_in_the_middle_of_a_face_acts_at_its_contact(contact: tuple[float, float, float]) -> None:
    rest = box()
    grid = CellGrid.fit(rest, 125)
    force = nodal_forces(grid, Surface.of(grid, rest), [push(contact)])[:, 0]
    np.testing.assert_allclose(centre(grid, force), contact, atol=2e-3)


def test_beside_the_foot_the_sole_and_the_edge_carry_nothing() -> None:
    """Of a face x = ¼ above z = 0, pushed at its lower edge: ∫ z w / ∫ w of w = (1 − r²/R²)² over a half disc is
    16 R/(35 π)·2 = 0.291 R."""
    rest = box()
    grid = CellGrid.fit(rest, 125)
    force = nodal_forces(grid, Surface.of(grid, rest), [push((0.25, 0.5, 0.0))])[:, 0]
    np.testing.assert_allclose(centre(grid, force), [0.25, 0.5, 32.0 / (35.0 * np.pi) * 0.15], atol=4e-3)


def test_only_the_side_of_a_sheet_that_faces_the_contact_is_pushed() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[30:34, 10:54, :50] = True
    grid = CellGrid.fit(rest, 125)
    force = nodal_forces(grid, Surface.of(grid, rest), [push((30 / 64, 0.5, 0.4), 0.2)])[:, 0]
    assert centre(grid, force)[0] == pytest.approx(30 / 64, abs=1e-3)


def test_where_no_surface_is_near_the_nearest_voxel_is_pushed() -> None:
    rest = box()
    grid = CellGrid.fit(rest, 125)
    near, far = push((0.5, 0.5, 0.625)), push((0.5, 0.5, 0.98), 0.03)
    forces = nodal_forces(grid, Surface.of(grid, rest), [near, far])
    np.testing.assert_allclose(centre(grid, forces[:, 1]), [0.5, 0.5, 0.617], atol=0.01)


def test_interpolation_reproduces_linear_functions_inside_and_shares_what_is_between_cells() -> None:
    """A plus sign of cells has empty corners: a point on their diagonal is as near to two cells."""
    rest = np.zeros((64, 64, 64), bool)
    rest[24:40, :, :16] = True
    rest[:, 24:40, :16] = True
    grid = CellGrid.fit(rest, 16)
    rng = np.random.default_rng(0)
    inside = np.stack([rng.uniform(0.4, 0.6, 50), rng.uniform(0.0, 1.0, 50), rng.uniform(0.0, 0.25, 50)])
    table = grid.interpolation(inside.astype(np.float32))
    np.testing.assert_allclose(table @ grid.node_positions, inside.T, atol=1e-5)
    corner = grid.interpolation(np.array([[0.2], [0.2], [0.1]], np.float32))[0]
    mean = corner @ grid.node_positions
    assert corner.sum() == pytest.approx(1.0, abs=1e-6)
    assert mean[0] == pytest.approx(mean[1], abs=1e-6)
