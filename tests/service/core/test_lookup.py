import numpy as np
import pytest

from service.core.lookup import motion, warp
from service.core.smoothing import smoothed


def at_voxels(field: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """The field at the centres of 64³ voxels, a quarter of the way between nodes; the last value outside."""
    fine = field.astype(np.float64)
    for axis in (1, 2, 3):
        padded = np.concatenate([fine.take([0], axis), fine, fine.take([-1], axis)], axis)
        before, here, behind = (padded.take(range(start, start + 32), axis) for start in range(3))
        shape = [64 if other == axis else size for other, size in enumerate(fine.shape)]
        fine = np.stack([0.75 * here + 0.25 * before, 0.75 * here + 0.25 * behind], axis + 1).reshape(shape)
    fine[..., 0] *= ~rest[..., 0]
    return fine


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


def bent(seed: int, peak: float = 0.03) -> np.ndarray:
    coarse = np.random.default_rng(seed).normal(0.0, peak, (3, 4, 4, 4)).astype(np.float32)
    return np.ascontiguousarray(coarse.repeat(8, 1).repeat(8, 2).repeat(8, 3))


@pytest.mark.parametrize("corner", [(20, 25, 10), (0, 0, 0), (54, 49, 39)])
def test_warping_looks_the_body_up_where_each_voxel_comes_from(corner: tuple[int, int, int]) -> None:
    """The body's box and how far the field moves it bound what is looked up; the answer knows nothing of it."""
    x, y, z = corner
    rest = np.zeros((64, 64, 64), bool)
    rest[x : x + 10, y : y + 15, z : z + 25] = np.random.default_rng(0).random((10, 15, 25)) < 0.9
    rest[x + 2 : x + 8, y + 2 : y + 8, z + 2 : z + 20] = True
    field = bent(1)
    expected = at(smoothed(rest), np.indices((64, 64, 64)) - 64 * at_voxels(field, rest))
    np.testing.assert_allclose(warp(rest, field), expected, atol=1e-4)
    assert (expected > 0).sum() > 2000
    assert not warp(np.zeros_like(rest), field).any()


def test_a_body_that_leaves_the_grid_is_gone() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[20:30, 25:40, 10:35] = True
    away = np.zeros((3, 32, 32, 32), np.float32)
    away[0] = 2.0
    assert not warp(rest, away).any()
    away[0, 5, 5, 5] = np.nan
    assert not warp(rest, away).any()


def test_motion_is_the_field_in_the_deformed_body_in_metres() -> None:
    rng = np.random.default_rng(7)
    rest, deformed = rng.random((2, 64, 64, 64)) < 0.1
    deformed[:, 20:23] = deformed[5] = False
    field = bent(2)
    moved = motion(field, rest, deformed, 0.3)
    expected = 0.3 * at_voxels(field, rest) * deformed
    np.testing.assert_allclose(moved.displacement_m, expected, atol=1e-7)
    lengths_m = np.linalg.norm(expected, axis=0)[deformed]
    assert moved.max_m == pytest.approx(lengths_m.max(), rel=1e-5)
    assert moved.mean_m == pytest.approx(lengths_m.mean(), rel=1e-5)


def test_nothing_has_not_moved() -> None:
    nothing = np.zeros((64, 64, 64), bool)
    moved = motion(bent(3), nothing, nothing, 0.3)
    assert (moved.max_m, moved.mean_m) == (0.0, 0.0)
    assert not moved.displacement_m.any()


def test_what_stands_on_the_floor_does_not_move() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[10:20, 10:20, :5] = True
    everywhere = np.ones_like(rest)
    moved_m = motion(np.ones((3, 32, 32, 32), np.float32), rest, everywhere, 1.0).displacement_m
    assert not moved_m[:, 10:20, 10:20, 0].any()
    assert moved_m[:, 9, 10, 0].all()
    assert moved_m[:, :, :, 1:].all()


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
    np.testing.assert_allclose(still, smoothed(rest), atol=1e-6)
