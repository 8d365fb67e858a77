import numpy as np
import pytest

from training.metrics import (
    active_latents,
    calibration_curve,
    calibration_error,
    chamfer_distance,
    changed_voxel_iou,
    displacement_error,
    error_of_curve,
    f_score,
    iou,
    skill,
    surface,
    visible_and_occluded_iou,
)


def block(*voxels: tuple[int, int, int]) -> np.ndarray:
    grid = np.zeros((4, 4, 4), bool)
    for voxel in voxels:
        grid[voxel] = True
    return grid


A, B, C = (0, 0, 0), (1, 0, 0), (2, 0, 0)


def test_iou_counts_voxels() -> None:
    assert iou(block(A, B), block(B, C)) == pytest.approx(1 / 3)
    assert iou(block(A), block(A)) == 1.0
    assert iou(block(A), block(B)) == 0.0


def test_two_empty_grids_agree_and_one_does_not() -> None:
    assert iou(block(), block()) == 1.0
    assert iou(block(), block(A)) == 0.0


def test_skill_is_the_share_of_the_room_that_was_gained() -> None:
    model, identity = np.array([0.9, 0.6, 0.5, 1.0]), np.array([0.8, 0.6, 0.6, 0.2])
    np.testing.assert_allclose(skill(model, identity), [0.5, 0.0, -0.25, 1.0])


def test_where_nothing_moves_there_is_nothing_to_gain_but_something_to_lose() -> None:
    np.testing.assert_array_equal(skill(np.array([1.0, 0.99]), np.array([1.0, 1.0])), [0.0, -1.0])


def test_changed_voxels_are_judged_alone() -> None:
    """At rest A; in truth it moved to B; the model fills B and leaves A: one of the two changes is right."""
    assert changed_voxel_iou(block(A, B), block(B), block(A)) == pytest.approx(0.5)
    assert changed_voxel_iou(block(B), block(B), block(A)) == 1.0
    assert changed_voxel_iou(block(A), block(B), block(A)) == 0.0
    assert changed_voxel_iou(block(A), block(A), block(A)) == 1.0


def test_a_latent_is_active_where_its_mean_varies_by_more_than_a_hundredth() -> None:
    """Variances 0, 0.0025 (±0.05), 0.0225 (±0.15) and 1: the last two count."""
    sign = np.array([1.0, -1.0])[:, None]
    assert active_latents(5.0 + sign * np.array([[0.0, 0.05, 0.15, 1.0]])) == 2


def test_displacement_error_by_hand() -> None:
    """Truth (0.3, 0.4, 0) in the body, half an edge; errors there 0, 0.1, 0.2 and 0.3 edges along z."""
    truth, predicted = np.zeros((3, 4, 4, 4)), np.zeros((3, 4, 4, 4))
    inside = block((0, 0, 0), (1, 0, 0), (2, 0, 0), (3, 0, 0))
    truth[0][inside], truth[1][inside] = 0.3, 0.4
    predicted[...] = truth
    predicted[2, :, 0, 0] = [0.0, 0.1, 0.2, 0.3]
    predicted[:, 3, 3, 3] = 9.0  # outside the body anything goes
    error = displacement_error(predicted, truth, inside)
    assert error["mean_voxels"] == pytest.approx(0.15 * 64)
    assert error["p95_voxels"] == pytest.approx(0.285 * 64)  # 0.95 of the way over three gaps: 2.85 tenths
    assert error["mean_of_peak"] == pytest.approx(0.3)
    assert error["p95_of_peak"] == pytest.approx(0.57)


def test_a_body_at_rest_has_no_peak_to_measure_by() -> None:
    still = np.zeros((3, 4, 4, 4))
    assert set(displacement_error(still, still, block(A)).values()) == {0.0}
    assert displacement_error(still + 0.1, still, block(A))["mean_of_peak"] == 1.0
    with pytest.raises(ValueError, match="empty body"):
        displacement_error(still, still, block())


def test_the_surface_is_what_has_a_face_outside() -> None:
    cube = np.zeros((7, 7, 7), bool)
    cube[1:6, 1:6, 1:6] = True
    assert surface(cube).sum() == 5**3 - 3**3
    assert surface(np.ones((4, 4, 4), bool)).sum() == 4**3 - 2**3


def test_chamfer_and_f_score_by_hand() -> None:
    """Two voxels against one, three apart: distances 0 and 3 one way, 0 the other; precision ½, recall 1."""
    one, two = block((0, 0, 0)), block((0, 0, 0), (3, 0, 0))
    assert chamfer_distance(two, one) == pytest.approx((1.5 + 0.0) / 2)
    assert f_score(two, one) == pytest.approx(2 * 0.5 / 1.5)
    assert chamfer_distance(two, two) == 0.0
    assert f_score(two, two) == 1.0
    assert f_score(block((0, 0, 0)), block((3, 3, 3))) == 0.0


def test_one_voxel_aside_is_within_one_voxel_and_a_diagonal_is_not() -> None:
    assert f_score(block(A), block(B)) == 1.0
    assert f_score(block((0, 0, 0)), block((1, 1, 0))) == 0.0


def test_nothing_has_no_surface() -> None:
    with pytest.raises(ValueError, match="empty body"):
        chamfer_distance(block(), block(A))


def test_what_was_seen_and_what_was_not_are_judged_apart() -> None:
    """Seen: voxel 0 of a row, and with it its neighbour. There the answer is right; beyond it has one of two."""
    observed, truth = np.zeros((8, 8, 8), bool), np.zeros((8, 8, 8), bool)
    observed[0, 0, 0] = True
    truth[0:4, 0, 0] = True
    predicted = truth.copy()
    predicted[3, 0, 0] = False
    assert visible_and_occluded_iou(predicted, truth, observed) == (1.0, 0.5)
    assert visible_and_occluded_iou(predicted, truth, np.zeros_like(observed)) == (1.0, 0.75)


def test_calibration_error_by_hand() -> None:
    """Of ten voxels at 0.7 six are true, of ten at 0.2 three: ½·|0.7 - 0.6| + ½·|0.2 - 0.3|."""
    probability = np.repeat([0.7, 0.2], 10)
    truth = np.concatenate([np.arange(10) < 6, np.arange(10) < 3])
    assert calibration_error(probability, truth) == pytest.approx(0.1)
    assert calibration_error(np.array([1.0, 0.0]), np.array([True, False])) == 0.0
    assert calibration_error(np.zeros(0), np.zeros(0, bool)) == 0.0


def test_the_calibration_curve_by_hand() -> None:
    voxels, said, found = calibration_curve(np.array([0.1, 0.6, 0.7, 1.0]), np.array([False, True, False, True]), 2)
    assert voxels.tolist() == [1.0, 3.0]
    assert said.tolist() == pytest.approx([0.1, 2.3])
    assert found.tolist() == [0.0, 2.0]


def test_doubts_of_several_grids_may_cancel() -> None:
    """One grid is always right at one half, the other never: each is off by one half, the two together by nothing."""
    probability, right, wrong = np.full(8, 0.5), np.ones(8, bool), np.zeros(8, bool)
    each = [calibration_curve(probability, truth) for truth in (right, wrong)]
    assert [error_of_curve(curve) for curve in each] == [0.5, 0.5]
    assert error_of_curve(each[0] + each[1]) == 0.0
