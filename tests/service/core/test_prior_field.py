import numpy as np
import pytest

from service.core.prior_cells import Cells
from service.core.prior_field import Points, backward_fields, held
from service.core.prior_grid import CellGrid
from service.core.prior_rotation import exponential


def body() -> np.ndarray:
    rest = np.zeros((64, 64, 64), bool)
    rest[20:44, 24:40, :50] = True
    return rest


@pytest.mark.parametrize("angle_deg", [0.0, 30.0, 90.0, 150.0])
def test_the_backward_field_of_an_affine_motion_is_exact_in_the_body(angle_deg: float) -> None:
    """y = F x + t has u_b(y) = y − F⁻¹(y − t), however far it turns."""
    grid = CellGrid.fit(body(), 64)
    zero = np.float32(0.0)
    turn = np.reshape(exponential(zero, np.float32(np.deg2rad(angle_deg)), zero), (3, 3))
    deformation = (turn @ np.diag([1.2, 0.9, 0.8])).astype(np.float32)
    centre = np.array([0.5, 0.5, 0.4])
    nodes = grid.node_positions - centre
    moved = (nodes @ deformation.T - nodes).T.astype(np.float32)
    field = backward_fields(Points.of(grid), Cells.of(grid, 0.3), moved[None])[0]
    lattice = np.stack(np.meshgrid(*[(np.arange(32) + 0.5) / 32] * 3, indexing="ij"))
    rest = np.einsum("ij,jxyz->ixyz", np.linalg.inv(deformation), lattice - centre[:, None, None, None])
    expected = lattice - centre[:, None, None, None] - rest
    inside = (np.abs(rest + (centre - [0.5, 0.5, 0.39])[:, None, None, None]) < 0.1).all(axis=0)
    assert inside.sum() > 100
    np.testing.assert_allclose(field[:, inside], expected[:, inside], atol=2e-4)


def test_fields_are_those_of_each_load_alone_whatever_their_number() -> None:
    grid = CellGrid.fit(body(), 64)
    points, cells = Points.of(grid), Cells.of(grid, 0.3)
    moved = np.random.default_rng(0).normal(0.0, 0.02, (4, 3, len(grid.nodes))).astype(np.float32)
    together = backward_fields(points, cells, moved)
    for i in (0, 3):
        np.testing.assert_array_equal(together[i], backward_fields(points, cells, moved[i : i + 1])[0])


def test_what_is_held_moves_no_farther_than_it_is_high_and_as_before() -> None:
    field = np.random.default_rng(1).normal(0.0, 0.2, (3, 32, 32, 32)).astype(np.float32)
    field[:, 3] = 0.0
    found, height = held(field), (np.arange(32) + 0.5) / 32
    length = np.linalg.norm(field, axis=0)
    np.testing.assert_allclose(np.linalg.norm(found, axis=0), np.minimum(length, height), atol=1e-6)
    np.testing.assert_allclose(np.cross(field, found, axis=0), 0.0, atol=1e-6)
    np.testing.assert_array_equal(found[:, length < height], field[:, length < height])
