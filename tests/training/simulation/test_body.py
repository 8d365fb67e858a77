import numpy as np
import pytest

from tests.training.simulation.bodies import bridge, column, sphere, union
from training.simulation.body import Body, BodyError
from training.simulation.sampled import octant_fill


def test_fill_fractions_give_the_volume_of_a_sphere():
    """V = 4π r³/3, within 0.2 % at 24³."""
    fill = octant_fill(sphere([0.5, 0.47, 0.52], 0.3), 24)
    assert fill.mean() == pytest.approx(4 / 3 * np.pi * 0.3**3, rel=2e-3)


def test_volume_counts_octants_that_are_floored_as_empty():
    body = Body.from_distance(column(0.3, 0.6), 20)
    assert body.volume == pytest.approx(0.3**2 * 0.6, rel=5e-3)


def test_node_numbers_point_at_their_own_corner():
    body = Body.from_distance(bridge(), 12)
    for local in (0, 3, 5, 7):
        corner = body.active + np.array([local >> 2 & 1, local >> 1 & 1, local & 1])
        np.testing.assert_array_equal(body.node_grid[body.cell_nodes[:, local]], corner)


@pytest.mark.parametrize(
    ("shape", "reason"),
    [
        (sphere([0.5, 0.5, 3.0], 0.3), "empty"),
        (sphere([0.5, 0.5, 0.6], 0.2), "not_standing"),
        (union(column(0.2, 0.3), sphere([0.5, 0.5, 0.7], 0.15)), "disconnected"),
    ],
)
def test_shapes_that_cannot_be_simulated_are_named(shape, reason):
    with pytest.raises(BodyError) as caught:
        Body.from_distance(shape, 16)
    assert caught.value.reason == reason


def test_surface_points_lie_on_the_surface_with_outward_normals():
    body = Body.from_distance(sphere([0.5, 0.5, 0.28], 0.3), 24)
    points, normals = body.surface_points(300, np.random.default_rng(3))
    radial = points - [0.5, 0.5, 0.28]
    np.testing.assert_allclose(np.linalg.norm(radial, axis=1), 0.3, atol=1e-4)
    assert ((radial / 0.3 * normals).sum(axis=1) > 0.999).all()
    assert (points[:, 2] > 0.02).all()


def test_surface_points_are_spread_by_area():
    """The upper half of a box 0.4 × 0.4 × 0.4 above z = 0.02 holds (4·0.2 + 0.4)/(4·0.38 + 0.4) of the area."""
    body = Body.from_distance(column(0.4, 0.4), 20)
    points, _ = body.surface_points(4000, np.random.default_rng(5))
    assert (points[:, 2] > 0.2).mean() == pytest.approx((4 * 0.2 + 0.4) / (4 * 0.38 + 0.4), abs=0.04)


def test_locate_gives_cell_and_local_coordinates():
    body = Body.from_distance(column(0.5, 0.5), 8)
    cell, local = body.locate(np.array([[0.30, 0.26, 0.01], [0.05, 0.5, 0.5], [2.0, 0.0, 0.0]]))
    np.testing.assert_array_equal(body.active[cell[0]], [2, 2, 0])
    np.testing.assert_allclose(local[0], [0.4, 0.08, 0.08])
    assert cell[1] == cell[2] == -1
