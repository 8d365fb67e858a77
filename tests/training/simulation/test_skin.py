import numpy as np
import pytest

from tests.training.simulation.bodies import box, sphere, union
from training.simulation.patch import surface_patch
from training.simulation.sampled import SampledDistance
from training.simulation.skin import Skin

BALL = sphere([0.5, 0.48, 0.31], 0.3)
BOX = box([0.511, 0.48, 0.217], [0.203, 0.117, 0.211])
WALL = box([0.5, 0.5, 0.2], [0.3, 1.4 / 24, 0.2])
SEAM = union(BALL, box([0.5, 0.48, 0.1], [0.35, 0.1, 0.1]))
PLACES = {
    "pole of a ball": (BALL, [0.5, 0.48, 0.61]),
    "face of a box": (BOX, [0.714, 0.48, 0.22]),
    "edge of a box": (BOX, [0.714, 0.48, 0.428]),
    "thin wall": (WALL, [0.5, 0.5 - 1.4 / 24, 0.2]),
    "seam": (SEAM, [0.75, 0.48, 0.2]),
}
_skins: dict[int, Skin] = {}


def skin_of(distance):
    if id(distance) not in _skins:
        _skins[id(distance)] = Skin.of(SampledDistance.of(distance, 24))
    return _skins[id(distance)]


@pytest.mark.parametrize("radius", [0.08, 0.2])
@pytest.mark.parametrize("name", PLACES)
def test_a_part_of_the_skin_integrates_as_a_fine_lattice_of_its_own(name, radius):
    """Weighted as a load is, (1 − r²/R²)²: the whole, the resultant of the normals and the first moment."""
    distance, centre = PLACES[name]
    centre = np.array(centre)
    skin = skin_of(distance)

    def integrals(points, normals, area):
        squared = ((points - centre) ** 2).sum(axis=1) / radius**2
        weight = area * np.clip(1.0 - squared, 0.0, None) ** 2
        return weight.sum(), weight @ normals, weight @ (points - centre)

    area, normal, moment = integrals(skin.points, skin.normals, skin.area)
    exact_area, exact_normal, exact_moment = integrals(*surface_patch(distance, centre, radius, radius / 40))
    assert area == pytest.approx(exact_area, rel=0.04)
    np.testing.assert_allclose(normal, exact_normal, atol=0.04 * exact_area)
    np.testing.assert_allclose(moment, exact_moment, atol=0.02 * exact_area * radius)


def test_points_of_a_ball_lie_on_it_and_carry_its_area():
    skin = skin_of(BALL)
    np.testing.assert_allclose(np.linalg.norm(skin.points - [0.5, 0.48, 0.31], axis=1), 0.3, atol=2e-4)
    np.testing.assert_allclose(skin.normals, (skin.points - [0.5, 0.48, 0.31]) / 0.3, atol=5e-3)
    assert skin.area.sum() == pytest.approx(4 * np.pi * 0.3**2, rel=0.005)


@pytest.mark.parametrize("shift", [0.0, 0.003, 0.0052])
def test_a_face_along_the_axes_has_its_area_wherever_it_lies(shift):
    """Hann's window sums to a constant over a lattice; a linear one would be off by up to 11 %."""
    skin = skin_of(box([0.5, 0.5, 0.25 + shift], [0.2, 0.2, 0.2]))
    top = (skin.normals[:, 2] > 0.999) & (np.abs(skin.points[:, :2] - 0.5) < 0.125).all(axis=1)
    assert skin.area[top].sum() == pytest.approx(0.25**2, rel=0.002)


def test_the_function_is_asked_along_edges_only():
    asked = []

    def counted(points):
        asked.append(len(points))
        return BALL(points)

    sampled = SampledDistance.of(counted, 24)
    asked.clear()
    Skin.of(sampled)
    assert sum(asked) == 0
    edged = SampledDistance.of(lambda points: counted(points) * 0 + BOX(points), 24)
    asked.clear()
    points = len(Skin.of(edged).points)
    assert 0 < sum(asked) < 5 * points
