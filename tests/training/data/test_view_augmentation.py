"""Changed views are views: of mapped bodies by mapped cameras, by sensors that say less or a little wrong."""

from dataclasses import replace

import numpy as np
import pytest
from jaxtyping import Float64
from scipy.ndimage import binary_dilation

from service.core.arrays import Matrix3, Occupancy, Vector3
from training.data.view_augmentation import (
    LARGEST_ZOOM,
    Seen,
    ViewAugmentation,
    augmented,
    cylinder,
    draw_map,
    extent,
    holed,
    mapped,
    placement,
    shadow,
    strays,
)

EYE = np.array([-70.0, 20.0, 90.0])
MIDDLE, RADII = np.array([28.0, 31.0, 16.0]), np.array([20.0, 23.0, 16.0])
NOTHING = replace(ViewAugmentation(), mapped=0.0, holed=0.0, shadowed=0.0, strayed=0.0, thinned=0.0)
CENTRES = np.moveaxis(np.indices((64, 64, 64)), 0, -1) + 0.5


def seen_from(eye: Vector3, middle: Vector3, sphere_from_place: Matrix3) -> Seen:
    """What a camera sees of an ellipsoid, from where a line meets a sphere: no sensor, no pixels."""
    start, place = (eye - middle) @ sphere_from_place.T, (CENTRES - middle) @ sphere_from_place.T
    ray = place - start
    a, b, c = (ray * ray).sum(-1), ray @ start, start @ start - 1.0
    root = b * b - a * c
    hit = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)  # 1 is the voxel's own place
    truth = (place * place).sum(-1) < 1.0
    depth = (hit - 1.0) * np.linalg.norm(CENTRES - eye, axis=-1)  # voxels from here to the surface, along the ray
    observed = np.abs(depth) < 0.7
    return Seen(observed, (depth > 0.7) & ~observed, truth)


@pytest.fixture(scope="module")
def ball() -> Seen:
    return seen_from(EYE, MIDDLE, np.diag(1 / RADII))


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def agreement(one: Occupancy, other: Occupancy) -> float:
    return float((one & other).sum() / (one | other).sum())


LINEAR = {
    "stretched": np.diag([1.3, 0.8, 0.9]),
    "turned, sheared and leaning": np.array([[0.95, -0.25, 0.2], [0.15, 1.1, -0.1], [0.0, 0.0, 1.1]]),
}


@pytest.mark.parametrize("name", LINEAR)
def test_the_image_of_a_view_is_the_view_of_the_image(ball: Seen, name: str) -> None:
    """A mapped camera sees of the mapped body what the map makes of what it saw."""
    image = mapped(ball, LINEAR[name], ball.observed)
    linear, offset = placement(ball.observed, LINEAR[name], ball.observed)
    expected = seen_from(
        linear @ EYE + offset, linear @ MIDDLE + offset, np.diag(1 / RADII) @ np.linalg.inv(linear)
    )  # fmt: skip
    # Nearest voxels are off by half a voxel at the surface, of a body some 40 across.
    assert agreement(image.truth, expected.truth) > 0.95
    assert agreement(image.free, expected.free) > 0.95
    # What is stretched is thicker than a surface where rays graze it.
    for one, other in ((image.observed, expected.observed), (expected.observed, image.observed)):
        assert (one & ~binary_dilation(other, np.ones((3, 3, 3)))).sum() < 0.05 * one.sum()


def test_each_voxel_is_the_nearest_of_the_view_and_as_free_as_its_rim_beyond_it(ball: Seen) -> None:
    """The loop beside a few lines of NumPy."""
    linear, offset = placement(ball.observed, LINEAR["stretched"], ball.observed)
    image = mapped(ball, LINEAR["stretched"], ball.observed)
    index = np.floor((CENTRES - offset) @ np.linalg.inv(linear).T).astype(int)
    inside = ((index >= 0) & (index < 64)).all(-1)
    assert 0.5 < inside.mean() < 0.95
    x, y, z = np.moveaxis(index.clip(0, 63), -1, 0)
    np.testing.assert_array_equal(image.observed, ball.observed[x, y, z] & inside)
    np.testing.assert_array_equal(image.truth, ball.truth[x, y, z] & inside)
    np.testing.assert_array_equal(image.free, ball.free[x, y, z])


def test_the_identity_leaves_every_voxel(ball: Seen) -> None:
    image = mapped(ball, np.eye(3), ball.observed)
    for kind in ("observed", "free", "truth"):
        np.testing.assert_array_equal(getattr(image, kind), getattr(ball, kind))


@pytest.mark.parametrize("seed", range(4))
def test_the_grid_is_laid_around_the_image_as_around_the_view(ball: Seen, seed: int) -> None:
    image = mapped(ball, draw_map(ViewAugmentation(), rng(seed)), ball.observed)
    before, after = extent(ball.observed, np.eye(3)), extent(image.observed, np.eye(3))
    assert after[0, 0] == pytest.approx(before[0, 0], abs=1.0)
    assert after[1].mean() == pytest.approx(before[1].mean(), abs=1.0)
    assert np.ptp(after, axis=1).max() == pytest.approx(np.ptp(before, axis=1).max(), abs=1.5)


def test_what_is_left_of_a_body_is_not_looked_at_from_too_near(ball: Seen) -> None:
    little = ball.observed & cylinder(np.argwhere(ball.observed)[0].astype(float), np.array([0.0, 0.0, 1.0]), 4.0)
    linear, _ = placement(little, np.eye(3), ball.observed)
    np.testing.assert_allclose(linear, LARGEST_ZOOM * np.eye(3))


def test_maps_keep_the_floor_and_are_drawn_both_ways() -> None:
    maps = np.stack([draw_map(ViewAugmentation(), rng(seed)) for seed in range(200)])
    assert not maps[:, 2, :2].any()
    assert (np.linalg.det(maps) > 0.2).all()
    logs = np.log(maps[:, 2, 2])
    assert abs(logs.mean()) < 0.05
    assert logs.std() == pytest.approx(ViewAugmentation().stretch, rel=0.2)
    leaning = (maps[:, :2, 2] != 0).any(axis=1).mean()
    assert leaning == pytest.approx(ViewAugmentation().leaning, abs=0.1)


def test_a_hole_takes_what_was_known_and_leaves_the_body(ball: Seen) -> None:
    for seed in range(5):
        left = holed(ball, 9.0, rng(seed))
        lost = int((ball.observed & ~left.observed).sum())
        assert 0 < lost <= 0.5 * ball.observed.sum()
        assert not (left.observed & ~ball.observed).any()
        assert not (left.free & ~ball.free).any()
        np.testing.assert_array_equal(left.truth, ball.truth)


def test_a_hole_that_would_take_most_of_the_view_is_left_out() -> None:
    speck = np.zeros((64, 64, 64), bool)
    speck[30:32, 30, 30] = True
    seen = Seen(speck, np.zeros_like(speck), speck)
    assert holed(seen, 9.0, rng()) is seen


def test_a_cylinder_is_as_wide_as_asked_for() -> None:
    along_z = cylinder(np.array([20.0, 30.0, 5.0]), np.array([0.0, 0.0, 1.0]), 2.5)
    assert (along_z == along_z[:, :, :1]).all()
    assert along_z[:, :, 0].sum() == 21  # places of a plane nearer than 2.5 to one of them
    assert along_z[22, 30, 40]
    assert not along_z[23, 30, 40]


def test_a_shadow_lies_beside_and_behind_never_before() -> None:
    one = np.zeros((64, 64, 64), bool)
    one[10, 20, 63] = True
    expected = np.zeros_like(one)
    expected[10:13, 18:23, 61:64] = True
    np.testing.assert_array_equal(shadow(one, 2), expected)


def test_strays_are_single_voxels_beside_and_behind() -> None:
    one = np.zeros((64, 64, 64), bool)
    one[10, 30, 30] = True
    places = np.argwhere(strays(one, 40, rng()))
    assert 20 < len(places) <= 40
    assert (places[:, 0] >= 10).all()
    assert np.ptp(places[:, 0]) > 5
    assert np.abs(places[:, 1:] - 30).max() < 15


def test_a_view_of_nothing_and_one_that_nothing_falls_on_stay_as_they_are(ball: Seen) -> None:
    nothing = Seen(np.zeros_like(ball.observed), ball.free, ball.truth)
    assert augmented(nothing, ViewAugmentation(), rng()) is nothing
    same = augmented(ball, NOTHING, rng())
    for kind in ("observed", "free", "truth"):
        np.testing.assert_array_equal(getattr(same, kind), getattr(ball, kind))


@pytest.mark.parametrize(
    ("share", "told"),
    [
        ("mapped", "truth"),
        ("holed", "observed"),
        ("shadowed", "free"),
        ("strayed", "observed"),
        ("thinned", "observed"),
    ],
)
def test_each_share_is_of_its_own_change(ball: Seen, share: str, told: str) -> None:
    changed = augmented(ball, replace(NOTHING, **{share: 1.0}), rng())
    assert (getattr(changed, told) != getattr(ball, told)).any()
    assert share == "mapped" or (changed.truth == ball.truth).all()


def test_a_change_is_repeated_by_the_same_chance_and_no_voxel_is_observed_and_free(ball: Seen) -> None:
    outcomes: list[Float64[np.ndarray, " kinds"]] = []
    for seed in (0, 0, 1, 2, 3):
        changed = augmented(ball, ViewAugmentation(), rng(seed))
        assert not (changed.observed & changed.free).any()
        outcomes.append(np.array([kind.sum() for kind in (changed.observed, changed.free, changed.truth)], float))
    assert (outcomes[0] == outcomes[1]).all()
    assert len({tuple(outcome) for outcome in outcomes}) == 4
