import numpy as np
import pytest

from service.core.grids import Grid
from service.core.voxels import VoxelView
from service.inference.registry import Models


@pytest.fixture(scope="module")
def view() -> VoxelView:
    """The front and the top of a block on the floor, seen from -x; what lies before and above is free."""
    observed, free = np.zeros((64, 64, 64), bool), np.zeros((64, 64, 64), bool)
    observed[16, 20:44, 0:36] = True
    observed[16:44, 20:44, 35] = True
    free[:16] = True
    free[:, :, 36:] = True
    return VoxelView(Grid(0.005, np.eye(4)), observed, free)


def test_free_voxels_are_empty_whatever_the_network_says(models: Models, view: VoxelView) -> None:
    probability = models.reconstruction(view)
    assert not probability[view.free].any()
    unruled = models.reconstruction(VoxelView(view.grid, view.observed, np.zeros_like(view.free)))
    assert unruled.max() > 0.5


def test_probabilities_are_probabilities(models: Models, view: VoxelView) -> None:
    probability = models.reconstruction(view)
    assert probability.dtype == np.float32
    assert probability.min() >= 0.0
    assert probability.max() <= 1.0


def test_the_shape_behind_what_is_seen_is_filled(models: Models, view: VoxelView) -> None:
    """The inside and most of the hidden back of a block of which two faces are seen."""
    filled = models.reconstruction(view) > models.reconstruction.manifest.threshold
    block = np.zeros_like(filled)
    block[16:44, 20:44, 0:36] = True
    assert (filled & block).sum() / block.sum() > 0.7
    assert filled.sum() > 3 * view.observed.sum()


def test_a_question_asked_twice_has_one_answer(models: Models, view: VoxelView) -> None:
    np.testing.assert_array_equal(models.reconstruction(view), models.reconstruction(view))
