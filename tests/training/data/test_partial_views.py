"""A body seen from all sides by a camera without noise."""

import dataclasses

import numpy as np

from service.core.grids import unpack_bits
from training.data.partial_views import PartialViewsConfig, draw_group, rotations


def test_there_are_125_different_rotations() -> None:
    """Wang et al. (IJCAI 2018), section 4.1: 5 angles around each axis."""
    turns = rotations(5)
    assert len(turns) == 125
    assert len({np.round(turn, 6).tobytes() for turn in turns}) == 125
    for turn in turns:
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-12)


def test_views_show_the_near_side_of_the_truth() -> None:
    group = draw_group(dataclasses.replace(PartialViewsConfig(), angles=2), 0)
    volumes = []
    for row in range(8):
        observed, free, truth = (unpack_bits(group[name][row]) for name in ("observed", "free", "truth"))
        volumes.append(truth.sum())
        assert not (free & observed).any()
        assert (free & truth).sum() < 0.01 * truth.sum()
        # x leads away from the camera: in every line of sight the first filled voxel is seen, give or take one.
        seen, hit = observed.any(axis=0), truth.any(axis=0)
        first_seen, first_hit = observed.argmax(axis=0), truth.argmax(axis=0)
        both = seen & hit
        assert both.sum() > 0.8 * hit.sum()
        assert (np.abs(first_seen - first_hit)[both] <= 2).mean() > 0.9
        border = truth.copy()
        border[1:-1, 1:-1, 1:-1] = False
        assert not border.any(), "the grid holds the whole body"
    # The same body in every view, but for how its faces fall on the voxels.
    np.testing.assert_allclose(volumes, np.mean(volumes), rtol=0.12)
