"""Kriging around a solve."""

import numpy as np
import pytest

from tests.training.experiments.test_released_bridge import BRIDGE, LOAD, drawn
from training.experiments.released_bridge import BridgeModel
from training.experiments.released_correction import Kriging, Ours, Recipe, Solve, layers, mean_iou, train_ours

SHARP = Recipe("solve", load=0.05, poisson=0.1, noise=1e-6)


def samples(count: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places, truths and what a solve says of them."""
    rng = np.random.default_rng(0)
    truth = (rng.random((count, 5)) > 0.5).astype(np.float32)
    return rng.random((count, 2)), truth, rng.random((count, 5)).astype(np.float32)


def exact() -> Solve:
    """The very bridge that was drawn."""
    return Solve(BridgeModel(BRIDGE, LOAD), slice(28, 36), (), np.full(9, 0.5, np.float32))


@pytest.mark.parametrize("around", ["solve", "mean"])
def test_training_samples_are_met_and_far_from_them_nothing_is_learnt(around: str) -> None:
    place, truth, before = samples()
    recipe = Recipe(around, load=0.5, poisson=0.5, noise=1e-6)  # type: ignore[arg-type]
    kriging = Kriging(recipe, place, truth, before)
    np.testing.assert_allclose(kriging(place, before), truth, atol=1e-3)
    expected = before[:1] if around == "solve" else truth.mean(axis=0)[None]
    np.testing.assert_allclose(kriging(np.array([[90.0, 0.0]]), before[:1]), expected, atol=1e-6)


def test_leaving_one_out_is_what_the_others_say_of_it() -> None:
    place, truth, before = samples()
    recipe = Recipe("solve", load=0.4, poisson=0.7, noise=0.1)
    left_out = Kriging(recipe, place, truth, before).left_out()
    for row in range(len(place)):
        others = np.arange(len(place)) != row
        said = Kriging(recipe, place[others], truth[others], before[others])(place[[row]], before[[row]])
        np.testing.assert_allclose(left_out[row], said[0], atol=1e-4)


def test_ragged_sides_are_told_from_full_layers() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[10:20, 24:40, 5] = True
    rest[10:20:2, 23, 5] = True
    rest[10:20:3, 40, 5] = True
    assert layers(rest) == (slice(24, 40), (23, 40))


def test_faces_are_as_full_as_training_samples_were_at_that_strain() -> None:
    rest, deformed, label = drawn()
    ragged, body = deformed.copy(), rest.copy()
    body[::2, 36] = body[::2, 30]
    strain = exact().model.shapes(label)[1]
    ragged[:, :, 36] = ragged[:, :, 30] & (strain < -0.003)
    solve = Solve.fit(label, ragged, body, sweeps=0)
    assert solve.faces == (36,)
    assert solve.share[0] > 0.7 > 0.3 > solve.share[-1]
    face = solve(label[:1])[0, :, 36]
    assert set(np.unique(face)) <= {np.float32(0.0), *solve.share}


def test_around_an_exact_solve_nothing_is_corrected() -> None:
    _, deformed, label = drawn()
    answer = Ours(exact(), SHARP)(label[:4], label[8:], deformed[8:])
    assert mean_iou(answer > 0.5, deformed[:4]) == 1.0


def test_the_recipe_for_softer_bodies_keeps_to_the_solve() -> None:
    """The mean of training samples says nothing of those beyond them."""
    rest, deformed, label = drawn()
    recipes = (Recipe("mean", 0.2, 0.7, 0.05), Recipe("solve", 0.2, 0.7, 0.05))
    ours = train_ours("soft", label[6:], deformed[6:], rest, recipes, sweeps=0)
    assert ours.recipe.around == "solve"


def test_the_recipe_for_random_samples_is_that_which_leaves_out_best() -> None:
    rest, deformed, label = drawn()
    recipes = (Recipe("mean", 0.01, 0.01, 0.05), Recipe("mean", 1.0, 2.0, 0.05))
    assert train_ours("random", label, deformed, rest, recipes, sweeps=0).recipe == recipes[1]
