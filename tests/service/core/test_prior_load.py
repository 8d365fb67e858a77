import numpy as np
import pytest

from service.core.prior_grid import CellGrid
from service.core.prior_load import _patch, nodal_forces


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


def gradient(rest: np.ndarray, floor: int) -> np.ndarray:
    """Of the occupancy at every voxel, outward; the floor goes on below."""
    padded = np.pad(rest.astype(float), 1)
    padded[1:-1, 1:-1, floor] = rest[:, :, floor]
    return np.stack([np.roll(padded, 1, axis) - np.roll(padded, -1, axis) for axis in range(3)], -1)[1:-1, 1:-1, 1:-1]


@pytest.mark.parametrize("floor", [0, 5, 50])
@pytest.mark.parametrize("contact", [(0.16, 0.4, 0.8), (0.98, 0.5, 0.8), (0.5, 0.01, 0.78)])
def test_a_patch_weighs_the_surface_as_the_formula_says(floor: int, contact: tuple[float, float, float]) -> None:
    """The surface is where the occupancy has a gradient."""
    rest = np.random.default_rng(floor).random((64, 64, 64)) < 0.02
    rest[10:, :50, 20:] = True
    rest[:, :, :floor] = False
    rest[5, 5, floor] = True
    near, radius = np.array(contact, np.float32), 0.1
    points, weights = _patch(rest.view(np.uint8), floor, near, np.float32(radius))
    normals = gradient(rest, floor)
    voxels = np.argwhere(rest & normals.any(axis=-1))
    outward = normals[tuple(voxels.T)]
    length = np.linalg.norm(outward, axis=1)
    places = (voxels + 0.5 + 0.5 * outward / length[:, None]) / 64
    squared = ((places - near) ** 2).sum(axis=1)
    share = np.exp(-0.5 * squared / (1.4 / 64) ** 2) * length * (squared < max(radius, 4 * 1.4 / 64) ** 2)
    expected = np.maximum(1.0 - squared / radius**2, 0.0) ** 2 * np.maximum(outward @ (share @ outward), 0.0)
    inside = squared < radius**2
    assert weights.max() > 0.0
    np.testing.assert_allclose(points.T, places[inside], atol=1e-6)
    np.testing.assert_allclose(weights, expected[inside], atol=1e-4 * expected.max())


def test_nodal_forces_sum_to_the_load() -> None:
    rest = box()
    grid = CellGrid.fit(rest, 125)
    loads = [push((0.5, 0.5, 0.625)), push((0.25, 0.4, 0.3)), push((0.75, 0.6, 0.02), 0.2)]
    forces = nodal_forces(grid, rest, loads)
    for i in range(3):
        np.testing.assert_allclose(forces[i].sum(axis=1), [6e-4, 0.0, -8e-4], atol=1e-9)


@pytest.mark.parametrize("contact", [(0.5, 0.5, 0.625), (0.25, 0.5, 0.3), (0.5, 0.6875, 0.3)])
def test_a_patch_in_the_middle_of_a_face_acts_at_its_contact(contact: tuple[float, float, float]) -> None:
    rest = box()
    grid = CellGrid.fit(rest, 125)
    force = nodal_forces(grid, rest, [push(contact)])[0]
    np.testing.assert_allclose(centre(grid, force), contact, atol=2e-3)


def test_beside_the_foot_the_sole_and_the_edge_carry_nothing() -> None:
    """Of a face x = ¼ above z = 0, pushed at its lower edge: ∫ z w / ∫ w of w = (1 − r²/R²)² over a half disc is
    16 R/(35 π)·2 = 0.291 R."""
    rest = box()
    grid = CellGrid.fit(rest, 125)
    force = nodal_forces(grid, rest, [push((0.25, 0.5, 0.0))])[0]
    np.testing.assert_allclose(centre(grid, force), [0.25, 0.5, 32.0 / (35.0 * np.pi) * 0.15], atol=4e-3)


def test_only_the_side_of_a_sheet_that_faces_the_contact_is_pushed() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[30:34, 10:54, :50] = True
    grid = CellGrid.fit(rest, 125)
    force = nodal_forces(grid, rest, [push((30 / 64, 0.5, 0.4), 0.2)])[0]
    assert centre(grid, force)[0] == pytest.approx(30 / 64, abs=1e-3)


def test_where_no_surface_is_near_the_nearest_voxel_is_pushed() -> None:
    rest = box()
    grid = CellGrid.fit(rest, 125)
    near, far = push((0.5, 0.5, 0.625)), push((0.5, 0.5, 0.98), 0.03)
    forces = nodal_forces(grid, rest, [near, far])
    np.testing.assert_allclose(centre(grid, forces[1]), [0.5, 0.5, 0.617], atol=0.01)


def test_forces_at_points_act_there_on_the_nodes_and_what_is_between_cells_is_shared() -> None:
    """A plus sign of cells has empty corners: a point on their diagonal is as near to two cells."""
    rest = np.zeros((64, 64, 64), bool)
    rest[24:40, :, :16] = True
    rest[:, 24:40, :16] = True
    grid = CellGrid.fit(rest, 16)
    rng = np.random.default_rng(0)
    inside = np.stack([rng.uniform(0.4, 0.6, 50), rng.uniform(0.0, 1.0, 50), rng.uniform(0.0, 0.25, 50)])
    one = np.ones(1, np.float32)
    for point in inside.T:
        shares = grid.at_nodes(point[:, None].astype(np.float32), one)
        np.testing.assert_allclose(shares @ grid.node_positions, point, atol=1e-5)
    corner = grid.at_nodes(np.array([[0.2], [0.2], [0.1]], np.float32), one)
    mean = corner @ grid.node_positions
    assert corner.sum() == pytest.approx(1.0, abs=1e-6)
    assert mean[0] == pytest.approx(mean[1], abs=1e-6)
