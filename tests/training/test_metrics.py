import numpy as np
import pytest

from training.metrics import changed_voxel_iou, iou, skill


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
