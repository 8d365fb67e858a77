"""The scene about a body, and the mask that comes with its frame."""

import numpy as np

from training.data.frames import _frayed, _scene
from training.data.views_config import ViewsConfig
from training.simulation.camera import Rendering, render, sample_viewpoint
from training.simulation.shapes import stand
from training.simulation.shapes.primitives import Box


def test_a_mask_of_a_detector_is_off_by_a_few_pixels() -> None:
    mask = np.zeros((60, 80), bool)
    mask[20:40, 30:50] = True
    frayed = [_frayed(mask, np.random.default_rng(seed)) for seed in range(20)]
    assert all(mask[24:36, 34:46].any() and (one[24:36, 34:46]).all() for one in frayed)
    assert not any(one[:15].any() or one[45:].any() or one[:, :25].any() or one[:, 55:].any() for one in frayed)
    assert len({one.tobytes() for one in frayed}) > 10


def scene(config: ViewsConfig, seed: int) -> tuple[Rendering, Rendering]:
    """A box in a scene of this configuration, and the same box alone on an endless plane."""
    shape = stand("box", Box((0.05, 0.04, 0.08)))
    viewpoint = sample_viewpoint(shape.bounds, np.random.default_rng(seed))
    return _scene(shape, viewpoint, config, np.random.default_rng(seed)), render(shape, *viewpoint)


def test_occluders_hide_a_part_of_the_object() -> None:
    config = ViewsConfig(clutter=1.0, occluder=1.0, table=0.0)
    hidden = []
    for seed in range(3):
        found, alone = scene(config, seed)
        assert not (found.mask & ~alone.mask).any()
        lost = alone.mask & ~found.mask
        assert (found.depth_m[lost] < alone.depth_m[lost]).all(), "what hides it is nearer"
        hidden.append(lost.sum() / alone.mask.sum())
    # Some bodies hide too much or nothing wherever they stand; those are left out.
    assert sum(config.hidden[0] <= part <= config.hidden[1] for part in hidden) >= 2
    # What it hides was told from a picture a quarter as wide.
    assert max(hidden) <= config.hidden[1] + 0.05


def test_clutter_beside_the_object_is_seen_and_tables_end() -> None:
    beside, alone = scene(ViewsConfig(clutter=1.0, occluder=0.0, table=0.0), 2)
    assert (beside.depth_m < alone.depth_m - 1e-3).sum() > 200
    ended, _ = scene(ViewsConfig(clutter=0.0, table=1.0), 2)
    np.testing.assert_array_equal(ended.mask, alone.mask)
    assert np.isnan(ended.depth_m).sum() > np.isnan(alone.depth_m).sum() + 1000
