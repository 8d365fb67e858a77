import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from service.core.displacement import corrected
from service.core.lookup import DOUBT, DOUBT_OF_MOTION, EVEN, Inside, Warp, warp
from service.core.smoothing import smoothed
from service.core.spread import Work
from tests.service.fields import at_voxels, bent, parted


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


def probability(values: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """How far from `EVEN`, beside how much there is to doubt: less by much where the body is still, more where not."""
    doubt = np.hypot(DOUBT, DOUBT_OF_MOTION * np.linalg.norm(displacement, axis=0)) * 4 * values * (1 - values)
    sure = (values - EVEN) / np.hypot(values - EVEN, doubt)
    return np.asarray(EVEN + sure * np.where(sure > 0, 1 - EVEN, EVEN))


@pytest.mark.parametrize("corner", [(20, 25, 10), (0, 0, 0), (54, 49, 39)])
def test_warping_looks_the_body_up_where_each_voxel_comes_from(corner: tuple[int, int, int]) -> None:
    """The body's box and how far the field moves it bound what is looked up; the answer knows nothing of it."""
    x, y, z = corner
    rest = np.zeros((64, 64, 64), bool)
    rest[x : x + 10, y : y + 15, z : z + 25] = np.random.default_rng(0).random((10, 15, 25)) < 0.9
    rest[x + 2 : x + 8, y + 2 : y + 8, z + 2 : z + 20] = True
    field = bent(1)
    smooth = smoothed(rest)
    displacement = at_voxels(field, rest)
    expected = at(smooth, np.indices((64, 64, 64)) - 64 * displacement)
    np.testing.assert_allclose(Warp(rest, Inside(smooth, probable=True))(field), expected, atol=1e-4)
    assert (expected > 0).sum() > 2000
    np.testing.assert_allclose(warp(rest, field), probability(expected, displacement), atol=4e-4)
    np.testing.assert_array_equal(Warp(rest, Inside(smooth, probable=False))(field), warp(rest, field))
    assert not warp(np.zeros_like(rest), field).any()


@pytest.mark.parametrize("middle", [1, 31, 32, 63])
def test_two_parts_find_what_the_whole_does(middle: int) -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[20:44, 12:50, :40] = True
    backward, correction = bent(5, 0.1), bent(6)[:, ::2, ::2, ::2]
    body = Warp(rest)
    field, probability = np.full_like(backward, np.nan), np.full(rest.shape, np.nan, np.float32)
    body.corrected(backward, correction, field, probability, parted(middle))
    np.testing.assert_array_equal(field, corrected(backward, correction, body.body))
    np.testing.assert_array_equal(probability, body(field))
    assert 5000 < (probability > 0.5).sum() < rest.sum() * 1.2


def test_two_threads_do_not_see_each_others_half_done_nodes() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[10:54, 12:50, :40] = True
    backward, correction = bent(5, 0.1), bent(6)[:, ::2, ::2, ::2]
    body = Warp(rest)
    expected = body(corrected(backward, correction, body.body))
    with ThreadPoolExecutor(1) as other:
        for late_s in np.linspace(0.0, 6e-4, 300):

            def both(work: Work, end: int, late_s: float = float(late_s)) -> None:
                upper = other.submit(lambda: (time.sleep(late_s), work(end // 2, end)))
                work(0, end // 2)
                upper.result()

            field, probability = np.empty_like(backward), np.empty(rest.shape, np.float32)
            body.corrected(backward, correction, field, probability, both)
            np.testing.assert_array_equal(probability, expected)


def test_nothing_is_corrected_where_there_is_no_body() -> None:
    field, probability = np.full((3, 32, 32, 32), np.nan, np.float32), np.full((64, 64, 64), np.nan, np.float32)
    Warp(np.zeros((64, 64, 64), bool)).corrected(bent(7), bent(8)[:, ::2, ::2, ::2], field, probability)
    np.testing.assert_array_equal(field, bent(7))
    assert not probability.any()


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
    np.testing.assert_allclose(still, probability(smoothed(rest), np.zeros((3, 1, 1, 1))), atol=1e-6)


def test_how_sure_an_answer_is_does_not_move_its_surface() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[20:30, 25:40, 10:35] = True
    field = bent(1)
    given = Warp(rest, Inside(smoothed(rest), probable=True))(field)
    answer = warp(rest, field)
    np.testing.assert_array_equal(answer > EVEN, given > EVEN)
    assert answer.min() == 0.0
    assert answer.max() == 1.0


def test_what_has_come_far_is_less_sure() -> None:
    """Of two bodies moved by whole voxels, which are looked up alike; sides still at 0 and 1 stay so."""
    rest = np.zeros((64, 64, 64), bool)
    rest[20:30, 25:40, 10:35] = True
    answers = []
    for voxels in (1, 8):
        field = np.zeros((3, 32, 32, 32), np.float32)
        field[0] = voxels / 64
        answers.append(np.roll(warp(rest, field), -voxels, axis=0)[:, :, 3:])  # above the sole, which stays
    near, far = answers
    unsure = (near > 0.0) & (near < 1.0)
    assert unsure.sum() > 1000
    nearer = (np.abs(near - EVEN) - np.abs(far - EVEN))[unsure]
    assert nearer.min() > 0.0
    assert nearer.mean() > 0.05
    np.testing.assert_array_equal(far[~unsure], near[~unsure])
