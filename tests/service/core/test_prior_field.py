import numpy as np
import pytest

from service.core.prior_field import backward_fields
from service.core.prior_grid import CellGrid
from service.core.prior_rotation import exponential, polar_rotation


def body() -> np.ndarray:
    rest = np.zeros((64, 64, 64), bool)
    rest[20:44, 24:40, :50] = True
    return rest


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0, 150.0])
def test_the_backward_field_of_an_affine_motion_is_exact_in_the_body(angle_deg: float) -> None:
    """y = F x + t has u_b(y) = y − F⁻¹(y − t), however far it turns."""
    grid = CellGrid.fit(body(), 64)
    turn = exponential(np.array([[0.0], [np.deg2rad(angle_deg)], [0.0]], np.float32))[..., 0]
    deformation = (turn @ np.diag([1.2, 0.9, 0.8])).astype(np.float32)
    centre = np.array([0.5, 0.5, 0.4])
    nodes = grid.node_positions - centre
    moved = (nodes @ deformation.T - nodes).T.astype(np.float32)
    gradient = np.repeat(deformation[:, :, None, None], len(grid.cells), axis=3)
    field = backward_fields(grid, moved[:, None], gradient)[0]
    lattice = np.stack(np.meshgrid(*[(np.arange(32) + 0.5) / 32] * 3, indexing="ij"))
    rest = np.einsum("ij,jxyz->ixyz", np.linalg.inv(deformation), lattice - centre[:, None, None, None])
    expected = lattice - centre[:, None, None, None] - rest
    inside = (np.abs(rest + (centre - [0.5, 0.5, 0.39])[:, None, None, None]) < 0.1).all(axis=0)
    assert inside.sum() > 100
    np.testing.assert_allclose(field[:, inside], expected[:, inside], atol=2e-4)


def test_fields_are_those_of_each_load_alone_whatever_their_number() -> None:
    grid = CellGrid.fit(body(), 64)
    rng = np.random.default_rng(0)
    moved = rng.normal(0.0, 0.02, (3, 11, len(grid.nodes))).astype(np.float32)
    gradient = np.eye(3)[:, :, None, None] + rng.normal(0.0, 0.2, (3, 3, 11, len(grid.cells)))
    gradient = gradient.astype(np.float32)
    together = backward_fields(grid, moved, gradient)
    for i in (0, 6, 10):
        alone = backward_fields(grid, moved[:, i : i + 1], gradient[:, :, i : i + 1])[0]
        np.testing.assert_allclose(together[i], alone, atol=1e-5)


def test_the_polar_rotation_of_a_stretched_rotation_is_the_rotation() -> None:
    rng = np.random.default_rng(0)
    rotation = exponential(rng.uniform(-1.7, 1.7, (3, 50)).astype(np.float32))
    np.testing.assert_allclose(np.linalg.det(rotation.transpose(2, 0, 1)), 1.0, atol=1e-5)
    noise = rng.normal(size=(50, 3, 3)) * 0.2
    stretch = np.eye(3) + 0.5 * (noise + noise.transpose(0, 2, 1))
    stretched = np.einsum("ijk,kjl->ilk", rotation, stretch).astype(np.float32)
    np.testing.assert_allclose(polar_rotation(stretched), rotation, atol=1e-4)
    np.testing.assert_allclose(polar_rotation(stretched, steps=3), rotation, atol=2e-3)


def test_an_inverted_cell_takes_the_rotation_of_its_skew_part() -> None:
    flat = np.diag([1.0, 1.0, -0.5]).astype(np.float32)[:, :, None]
    np.testing.assert_allclose(polar_rotation(flat)[..., 0], np.eye(3), atol=1e-6)
