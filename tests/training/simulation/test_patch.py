import numpy as np
import pytest

from tests.training.simulation.bodies import box, sphere, union
from training.simulation.patch import surface_patch
from training.simulation.sampled import SampledDistance

BALL = sphere([0.5, 0.48, 0.31], 0.3)
BOX = box([0.511, 0.48, 0.217], [0.203, 0.117, 0.211])
SHAPES = {
    "pole of a ball": (BALL, [0.5, 0.48, 0.61]),
    "face of a box": (BOX, [0.714, 0.48, 0.22]),
    "edge of a box": (BOX, [0.714, 0.48, 0.428]),
    "thin wall": (box([0.5, 0.5, 0.2], [0.3, 1.4 / 24, 0.2]), [0.5, 0.5 - 1.4 / 24, 0.2]),
    "seam": (union(BALL, box([0.5, 0.48, 0.1], [0.35, 0.1, 0.1])), [0.75, 0.48, 0.2]),
}


@pytest.mark.parametrize("radius", [0.08, 0.2])
@pytest.mark.parametrize("name", SHAPES)
def test_interpolated_values_integrate_as_those_of_the_function(name, radius):
    distance, centre = SHAPES[name]
    spacing = min(0.25 / 24, radius / 10)
    exact = surface_patch(distance, np.array(centre), radius, spacing)
    points, normals, area = surface_patch(SampledDistance.of(distance, 24), np.array(centre), radius, spacing)
    whole = exact[2].sum()
    assert area.sum() == pytest.approx(whole, rel=0.01)
    # first moments and the mean normal: what the resultant and the sense of a traction are made of
    np.testing.assert_allclose(area @ (points - centre), exact[2] @ (exact[0] - centre), atol=0.01 * whole * radius)
    np.testing.assert_allclose(area @ normals, exact[2] @ exact[1], atol=0.015 * whole)
    assert np.abs(np.linalg.norm(normals, axis=1) - 1.0).max() < 1e-6


def test_points_lie_on_a_ball():
    points, normals, area = surface_patch(SampledDistance.of(BALL, 24), np.array([0.5, 0.48, 0.61]), 0.1, 0.01)
    np.testing.assert_allclose(np.linalg.norm(points - [0.5, 0.48, 0.31], axis=1), 0.3, atol=2e-4)
    np.testing.assert_allclose(normals, (points - [0.5, 0.48, 0.31]) / 0.3, atol=5e-3)
    # a cap of chord R has the area π R²
    assert area.sum() == pytest.approx(np.pi * 0.1**2, rel=0.05)


def test_a_lattice_wider_than_what_was_sampled_asks_the_function():
    asked = []

    def distance(points):
        asked.append(len(points))
        return BALL(points)

    sampled = SampledDistance.of(distance, 24)
    asked.clear()
    surface_patch(sampled, np.array([0.5, 0.48, 0.61]), 0.1, 0.01)
    assert not asked
    surface_patch(sampled, np.array([0.5, 0.48, 0.61]), 0.3, 0.02)
    assert asked


def test_nothing_of_the_surface_is_out_of_reach_of_the_lattice():
    """Every point within the shell has values around it: as many points as without interpolation."""
    for distance, centre in SHAPES.values():
        plain = surface_patch(distance, np.array(centre), 0.2, 0.25 / 24)[2]
        found = surface_patch(SampledDistance.of(distance, 24), np.array(centre), 0.2, 0.25 / 24)[2]
        assert len(found) == pytest.approx(len(plain), rel=0.02)
