"""Views of one body through the camera, the sensor and the service's own perception."""

import dataclasses
import functools

import numpy as np
import pytest

from service.core.grids import unpack_bits
from training.data.generate import Dropped
from training.data.views import TIPPABLE, ViewsConfig, _frayed, _scene, draw_group
from training.metrics import iou
from training.simulation.camera import Rendering, render, sample_viewpoint
from training.simulation.shapes import stand
from training.simulation.shapes.primitives import Box

CONFIG = ViewsConfig(seed=0, views=2)


@functools.cache
def drawn(seed: int) -> dict[str, np.ndarray]:
    """The first body of a seed of which a view could be segmented."""
    for index in range(10):
        try:
            return draw_group(dataclasses.replace(CONFIG, seed=seed), index)
        except Dropped:
            continue
    raise AssertionError("ten bodies without a view")


@pytest.fixture(params=[0, 1])
def group(request: pytest.FixtureRequest) -> dict[str, np.ndarray]:
    return drawn(request.param)


def views(group: dict[str, np.ndarray]) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    columns = (group["observed"], group["free"], group["truth"])
    return [tuple(unpack_bits(bits) for bits in row) for row in zip(*columns, strict=True)]


def grown(occupancy: np.ndarray) -> np.ndarray:
    """The body and the 26 neighbours of its voxels."""
    padded = np.pad(occupancy, 1)
    result = np.zeros_like(occupancy)
    for x in range(3):
        for y in range(3):
            for z in range(3):
                result |= padded[x : x + 64, y : y + 64, z : z + 64]
    return result


def test_a_group_is_drawn_from_its_seed_alone() -> None:
    first, second = drawn(1), drawn.__wrapped__(1)
    for key in first:
        assert first[key].tobytes() == second[key].tobytes(), key


def test_a_round_footed_body_stands_on_a_part_of_its_width() -> None:
    families = ("superquadric", "can")
    config = dataclasses.replace(CONFIG, seed=4, families=families, stretch=0.0, undercut_share=(0.5, 0.5))
    shares = []
    for chance in (0.0, 1.0):
        truth = unpack_bits(draw_group(dataclasses.replace(config, undercut=chance), 0)["truth"][0])
        layers = truth.sum(axis=(0, 1))
        shares.append(layers[0] / layers.max())
    # half as wide both ways on the ground itself, a little more in the middle of the lowest voxels
    assert 0.2 * shares[0] < shares[1] < 0.5 * shares[0]


def test_one_view_does_not_depend_on_how_many_are_drawn() -> None:
    alone = draw_group(dataclasses.replace(CONFIG, seed=1, views=1), 0)
    assert alone["sample"][0, 0] == drawn(1)["sample"][0, 0] == 0
    assert alone["observed"][0].tobytes() == drawn(1)["observed"][0].tobytes()


def test_the_truth_covers_what_was_observed_within_a_voxel(group: dict[str, np.ndarray]) -> None:
    """But for the few points that the sensor's noise carries farther."""
    for observed, _, truth in views(group):
        assert (observed & grown(truth)).sum() / observed.sum() > 0.97


def test_hardly_any_of_the_body_is_seen_through(group: dict[str, np.ndarray]) -> None:
    for observed, free, truth in views(group):
        assert (free & truth).sum() / truth.sum() <= 0.02
        assert not (free & observed).any()


def test_the_body_stands_in_its_grid_and_is_seen_through_free_space(group: dict[str, np.ndarray]) -> None:
    for _, free, truth in views(group):
        assert truth[:, :, :2].any()
        assert free.mean() > 0.2


def test_a_view_shows_less_than_the_truth(group: dict[str, np.ndarray]) -> None:
    assert all(0.01 < iou(observed, truth) < 0.8 for observed, _, truth in views(group))


def test_the_way_a_body_is_drawn_is_told() -> None:
    lying = dataclasses.replace(CONFIG, seed=4, tipped=1.0, thin=1.0, thin_hollow=1.0, views=1)
    found = [draw_group(lying, index) for index in range(6)]
    assert all(group["thin"] for group in found)
    assert {int(group["pose"]) for group in found if str(group["family"]) in TIPPABLE} <= {1, 2}
    assert all(group["pose"] == 0 for group in found if str(group["family"]) not in TIPPABLE)
    assert any(group["pose"] > 0 for group in found)


def test_a_mask_of_a_detector_is_off_by_a_few_pixels() -> None:
    mask = np.zeros((60, 80), bool)
    mask[20:40, 30:50] = True
    frayed = [_frayed(mask, np.random.default_rng(seed)) for seed in range(20)]
    assert all(mask[24:36, 34:46].any() and (one[24:36, 34:46]).all() for one in frayed)
    assert not any(one[:15].any() or one[45:].any() or one[:, :25].any() or one[:, 55:].any() for one in frayed)
    assert len({one.tobytes() for one in frayed}) > 10


def test_sizes_are_those_asked_for(group: dict[str, np.ndarray]) -> None:
    assert ((group["sample"][:, 1] > 0.04) & (group["sample"][:, 1] < 0.6)).all()


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
