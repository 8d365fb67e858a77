"""Views of one body through the camera, the sensor and the service's own perception."""

import dataclasses
import functools

import numpy as np
import pytest

from service.core.grids import unpack_bits
from training.data.generate import Dropped
from training.data.views import draw_group
from training.data.views_config import TIPPABLE, ViewsConfig
from training.metrics import iou

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


def test_sizes_are_those_asked_for(group: dict[str, np.ndarray]) -> None:
    assert ((group["sample"][:, 1] > 0.04) & (group["sample"][:, 1] < 0.6)).all()
