import numpy as np
import pytest

from service.core.lookup import smoothed, stacked, trilinear, warp

PLACES = np.random.default_rng(1).uniform(0.0, 63.0, (3, 64, 64, 64)).astype(np.float32)


def test_a_trilinear_field_is_looked_up_exactly_but_for_the_weights_of_opencv() -> None:
    x, y, z = np.indices((64, 64, 64)).astype(np.float32)
    field = 0.5 * x - 0.25 * y + 0.125 * z + 0.001 * x * y
    expected = 0.5 * PLACES[0] - 0.25 * PLACES[1] + 0.125 * PLACES[2] + 0.001 * PLACES[0] * PLACES[1]
    # y and z are rounded to 1/32 voxel: at most 1/64 of the slope, here (0.25 + 0.063) / 64 + 0.125 / 64.
    np.testing.assert_allclose(trilinear(field, *PLACES), expected, atol=0.0075)


def test_at_voxel_centres_nothing_changes() -> None:
    field = np.random.default_rng(0).random((64, 64, 64), np.float32)
    np.testing.assert_allclose(trilinear(field, *np.indices((64, 64, 64)).astype(np.float32)), field, atol=1e-6)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize(
    ("place", "value"), [(-0.5, 0.5), (-1.0, 0.0), (-40.0, 0.0), (63.5, 0.5), (64.0, 0.0), (99.0, 0.0)]
)
def test_the_field_falls_to_zero_over_one_voxel_outside(axis: int, place: float, value: float) -> None:
    places = np.full((3, 64, 64, 64), 20.0, np.float32)
    places[axis] = place
    np.testing.assert_allclose(trilinear(np.ones((64, 64, 64), np.float32), *places), value, atol=1e-6)


def test_places_in_columns_are_looked_up_as_any_others() -> None:
    """What rounding of the weights leaves is 1/64 of the slope along each axis."""
    field = np.random.default_rng(4).random((64, 64, 64), np.float32)
    x, y = np.random.default_rng(5).uniform(-2.0, 65.0, (2, 64, 64)).astype(np.float32)
    z = np.linspace(-1.7, 64.9, 64)
    places = np.broadcast_arrays(x[:, :, None], y[:, :, None], z.astype(np.float32))
    np.testing.assert_allclose(stacked(field, x, y, z), trilinear(field, *places), atol=3 / 64)
    whole = np.indices((64, 64)).astype(np.float32)
    np.testing.assert_allclose(stacked(field, *whole, np.arange(64.0)), field, atol=1e-6)
    linear = np.broadcast_to(np.arange(64, dtype=np.float32), (64, 64, 64)).copy()
    np.testing.assert_allclose(stacked(linear, *whole, np.arange(63) + 0.3)[5, 7], np.arange(63) + 0.3, atol=1e-5)


def test_warping_a_part_of_the_grid_is_warping_all_of_it() -> None:
    """The body's box and how far the field moves it bound what is looked up; the answer knows nothing of it."""
    rest = np.zeros((64, 64, 64), bool)
    rest[20:30, 25:40, 10:35] = np.random.default_rng(0).random((10, 15, 25)) < 0.7
    coarse = np.random.default_rng(1).normal(0.0, 0.03, (3, 4, 4, 4)).astype(np.float32)
    displacement = np.ascontiguousarray(coarse.repeat(16, 1).repeat(16, 2).repeat(16, 3))
    indices = np.indices((64, 64, 64)).astype(np.float32)
    expected = trilinear(smoothed(rest), *(indices - 64 * displacement))
    np.testing.assert_allclose(warp(rest, displacement), expected, atol=1 / 16)
    assert (expected > 0).sum() > 2000
    assert not warp(np.zeros_like(rest), displacement).any()
    away = np.zeros_like(displacement)
    away[0] = 2.0
    assert not warp(rest, away).any()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_constant_displacement_moves_the_body_by_as_many_voxels(axis: int) -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[20:30, 25:40, 10:35] = True
    displacement = np.zeros((3, 64, 64, 64), np.float32)
    displacement[axis] = 7 / 64
    np.testing.assert_array_equal(warp(rest, displacement) > 0.5, np.roll(rest, 7, axis=axis))


def test_no_displacement_returns_the_body() -> None:
    rest = np.random.default_rng(2).random((64, 64, 64)) < 0.4
    still = warp(rest, np.zeros((3, 64, 64, 64), np.float32))
    np.testing.assert_array_equal(still > 0.5, rest)
    np.testing.assert_allclose(still, smoothed(rest), atol=1e-6)


def test_smoothing_finds_a_surface_between_voxels() -> None:
    """A half space under a plane that cuts the voxels askew: ½ is crossed within a third of a voxel of the plane."""
    x, y, z = (np.indices((24, 24, 24)) + 0.5).astype(np.float32)
    normal = np.array([0.27, 0.13, 1.0]) / np.linalg.norm([0.27, 0.13, 1.0])
    height = normal[0] * x + normal[1] * y + normal[2] * z - 14.2
    values = smoothed(height < 0.0)
    raw = (height < 0.0).astype(np.float32)

    def missed(field: np.ndarray) -> float:
        below = field[8:16, 8:16, 3:21]
        column = np.argmax(below < 0.5, axis=2)
        first, last = (np.take_along_axis(below, (column - i)[..., None], 2)[..., 0] for i in (1, 0))
        crossing = 3.5 + column - 1 + (first - 0.5) / (first - last)
        truth = (14.2 - normal[0] * x[8:16, 8:16, 0] - normal[1] * y[8:16, 8:16, 0]) / normal[2]
        return float(np.sqrt(np.mean((crossing - truth) ** 2)))

    assert missed(values) < 0.2 < missed(raw)


def test_a_rod_one_voxel_thin_survives_smoothing() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[30, 30, :40] = True
    np.testing.assert_array_equal(smoothed(rest) > 0.5, rest)
