import numpy as np
import pytest

from tests.training.simulation.bodies import box, bridge, sphere, union, whole_cube
from training.simulation.rasterise import voxel_centres
from training.simulation.sampled import INSIDE, NEAR, OUTSIDE, SampledDistance, interpolated, plain_side

SHAPES = {
    "ball": sphere([0.5, 0.47, 0.42], 0.3),
    "box off the grid": box([0.511, 0.48, 0.217], [0.203, 0.117, 0.211]),
    "bridge on the grid": bridge(),
    "ball on a box": union(box([0.5, 0.5, 0.1], [0.3, 0.3, 0.1]), sphere([0.5, 0.5, 0.3], 0.2)),
}


def plain_fill(distance, cells):
    """Share of every octant's 4³ samples, each asked of the function itself."""
    samples = (np.arange(8 * cells) + 0.5) / (8 * cells)
    points = np.stack(np.meshgrid(samples, samples, samples, indexing="ij"), axis=-1).reshape(-1, 3)
    share = np.clip(0.5 - distance(points.astype(np.float32)) * 8 * cells, 0.0, 1.0)
    return share.reshape((2 * cells, 4) * 3).mean(axis=(1, 3, 5))


@pytest.mark.parametrize("name", SHAPES)
def test_fill_is_the_share_of_all_samples(name):
    """Within 2 % of an octant everywhere, and 5e-4 of the volume: along edges interpolation rounds."""
    found, expected = SampledDistance.of(SHAPES[name], 12).octant_fill, plain_fill(SHAPES[name], 12)
    assert np.abs(found - expected).max() < 0.02
    assert found.sum() == pytest.approx(expected.sum(), rel=5e-4)


@pytest.mark.parametrize("name", SHAPES)
def test_signs_are_those_of_the_function(name):
    points = np.random.default_rng(3).random((100_000, 3)).astype(np.float32)
    sampled = SampledDistance.of(SHAPES[name], 12)
    np.testing.assert_array_equal(sampled.inside(points), SHAPES[name](points) < 0)


def test_only_points_in_doubt_are_asked():
    asked = []

    def distance(points):
        asked.append(len(points))
        return SHAPES["box off the grid"](points)

    sampled = SampledDistance.of(distance, 24)
    assert sum(asked) < 0.15 * 96**3  # the lattice has 97³ nodes
    asked.clear()
    sampled.inside(voxel_centres())
    assert sum(asked) < 0.005 * 64**3


def test_octants_far_from_the_surface_are_settled():
    sampled = SampledDistance.of(SHAPES["ball"], 12)
    assert sampled.state[12, 11, 10] == INSIDE
    assert sampled.state[0, 0, 0] == OUTSIDE
    assert sampled.state[12, 11, 17] == NEAR  # holds the top of the ball, z = 0.72
    assert (SampledDistance.of(whole_cube, 4).octant_fill == 1.0).all()


def test_interpolation_is_exact_for_quadratics():
    def quadratic(points):
        x, y, z = points.T
        return (0.3 * x - 0.2 * y * y + 0.3 * x * z + 0.1 * y * z * z * x * x - 0.2).astype(np.float32)

    sampled = SampledDistance.of(quadratic, 4)
    octant = np.argwhere(sampled.number >= 0)[7]
    local = np.array([0.2, -0.6, 0.9])
    value = interpolated(sampled.polynomial, sampled.number[tuple(octant)], *local.tolist())
    assert value == pytest.approx(quadratic((octant[None] + 0.5 + 0.5 * local) / 8)[0], abs=1e-7)


def test_doubt_bounds_the_error_of_interpolation():
    """Between the nodes of a ball's octants the interpolated distance is off by less than its doubt."""
    sampled = SampledDistance.of(SHAPES["ball"], 12)
    for octant in np.argwhere(sampled.state == NEAR)[::50]:
        local = np.random.default_rng(0).uniform(-1, 1, (20, 3))
        points = (octant + 0.5 + 0.5 * local) / 24
        row = sampled.number[tuple(octant)]
        found = [interpolated(sampled.polynomial, row, *place) for place in local.tolist()]
        error = np.abs(np.array(found) - SHAPES["ball"](points.astype(np.float32)))
        assert error.max() < sampled.doubt[row]


@pytest.mark.parametrize("name", SHAPES)
def test_an_octant_that_its_corners_settle_lies_on_that_side(name):
    """Tabulated octants that are not `NEAR`: the function has one sign in them, at edges too."""
    sampled = SampledDistance.of(SHAPES[name], 12)
    settled = np.argwhere((sampled.number >= 0) & (sampled.state != NEAR))
    local = np.random.default_rng(0).random((8, 1, 3))
    value = SHAPES[name](((settled + local) / 24).reshape(-1, 3).astype(np.float32)).reshape(8, -1)
    np.testing.assert_array_equal(value < 0, np.tile(sampled.state[tuple(settled.T)] == INSIDE, (8, 1)))
    assert len(settled) > 100


@pytest.mark.parametrize("name", SHAPES)
def test_where_the_plane_of_an_octant_tells_the_side_it_is_that_of_the_whole_polynomial(name):
    """Up to 1.004, a little beyond the octant; on smooth surfaces the plane tells most."""
    sampled = SampledDistance.of(SHAPES[name], 12)
    rows = sampled.number[sampled.state == NEAR][::31]
    local = np.random.default_rng(1).uniform(-1.004, 1.004, (len(rows), 20, 3))
    told = 0
    for row, places in zip(rows.tolist(), local.tolist(), strict=True):
        for place in places:
            side = plain_side(sampled.plane, row, *place)
            value = interpolated(sampled.polynomial, row, *place)
            assert side == NEAR or (side == INSIDE) == (value < -sampled.doubt[row] * (1 - 1e-6)), place
            assert side != OUTSIDE or value > sampled.doubt[row] * (1 - 1e-6), place
            told += side != NEAR
    if name == "ball":
        assert told > 0.6 * local.size / 3
