import numpy as np
import pytest

from service.core.lookup import EVEN, SHARPNESS, Inside, Warp, warp
from service.core.smoothing import smoothed
from tests.service.fields import at_voxels, bent


def at(values: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Trilinear lookup at places in voxels; beyond the outermost centres it falls to zero over one voxel."""
    padded = np.pad(values.astype(np.float64), 1)
    place = np.clip(places + 1.0, 0.0, 65.0)
    below = np.minimum(place.astype(int), 64)
    share = place - below
    result = np.zeros(places.shape[1:])
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod([share[axis] if corner[axis] else 1.0 - share[axis] for axis in range(3)], axis=0)
        result += weight * padded[below[0] + corner[0], below[1] + corner[1], below[2] + corner[2]]
    return result


def sharpened(values: np.ndarray) -> np.ndarray:
    """Odds to a power, the same where they are those of `EVEN`."""
    even = EVEN / (1.0 - EVEN)
    with np.errstate(divide="ignore"):
        odds = np.clip(values, 0.0, 1.0) / (1.0 - np.clip(values, 0.0, 1.0))
        return 1.0 - 1.0 / (1.0 + even * (odds / even) ** SHARPNESS)


@pytest.mark.parametrize("corner", [(20, 25, 10), (0, 0, 0), (54, 49, 39)])
def test_warping_looks_the_body_up_where_each_voxel_comes_from(corner: tuple[int, int, int]) -> None:
    """The body's box and how far the field moves it bound what is looked up; the answer knows nothing of it."""
    x, y, z = corner
    rest = np.zeros((64, 64, 64), bool)
    rest[x : x + 10, y : y + 15, z : z + 25] = np.random.default_rng(0).random((10, 15, 25)) < 0.9
    rest[x + 2 : x + 8, y + 2 : y + 8, z + 2 : z + 20] = True
    field = bent(1)
    smooth = smoothed(rest)
    expected = at(smooth, np.indices((64, 64, 64)) - 64 * at_voxels(field, rest))
    np.testing.assert_allclose(Warp(rest, Inside(smooth, probable=True))(field), expected, atol=1e-4)
    assert (expected > 0).sum() > 2000
    np.testing.assert_allclose(warp(rest, field), sharpened(expected), atol=4e-4)
    np.testing.assert_array_equal(Warp(rest, Inside(smooth, probable=False))(field), warp(rest, field))
    assert not warp(np.zeros_like(rest), field).any()


def test_a_body_that_leaves_the_grid_is_gone() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[20:30, 25:40, 10:35] = True
    away = np.zeros((3, 32, 32, 32), np.float32)
    away[0] = 2.0
    assert not warp(rest, away).any()
    away[0, 5, 5, 5] = np.nan
    assert not warp(rest, away).any()


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_constant_displacement_moves_the_body_by_as_many_voxels(axis: int) -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[20:30, 25:40, 10:35] = True
    field = np.zeros((3, 32, 32, 32), np.float32)
    field[axis] = 7 / 64
    np.testing.assert_array_equal(warp(rest, field) > 0.5, np.roll(rest, 7, axis=axis))


def test_no_displacement_returns_the_body() -> None:
    rest = np.random.default_rng(2).random((64, 64, 64)) < 0.4
    still = warp(rest, np.zeros((3, 32, 32, 32), np.float32))
    np.testing.assert_array_equal(still > 0.5, rest)
    np.testing.assert_allclose(still, sharpened(smoothed(rest)), atol=1e-6)


def test_how_sure_an_answer_is_does_not_move_its_surface() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[20:30, 25:40, 10:35] = True
    field = bent(1)
    unsure = Warp(rest, Inside(smoothed(rest), probable=True))(field)
    sure = warp(rest, field)
    np.testing.assert_array_equal(sure > EVEN, unsure > EVEN)
    assert ((sure > EVEN) == (sure >= unsure))[(unsure > 0.01) & (unsure < 0.99)].all()
