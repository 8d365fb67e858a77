from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from service.core.condition import CONDITION_FIELDS
from service.core.displacement import corrected
from service.core.lookup import Inside, Warp, warp
from service.core.motion import motion
from service.core.prior import ElasticPrior
from service.core.spread import Spread
from service.inference.bodies import KEPT_BODIES
from service.inference.deformation import DeformationModel
from service.inference.registry import Models, load_models

BODY = np.zeros((64, 64, 64), bool)
BODY[24:40, 20:44, 0:44] = True
"""A block on the floor, pushed on its upper end."""
EVERYWHERE = np.ones(BODY.shape, np.float32)


def displacement(field: np.ndarray) -> np.ndarray:
    """At every voxel, in edges of the grid."""
    return motion(field, BODY, EVERYWHERE, 0.5, 1.0).moved_m.reshape(3, 64, 64, 64)


def push(y: float = 0.5, direction: tuple[float, float, float] = (1.0, 0.0, 0.0), log_load: float = -2.5) -> np.ndarray:
    return np.array([24 / 64, y, 0.6, *direction, log_load, 0.3, 0.12], np.float32)


def test_a_batch_of_loads_is_each_load_on_its_own(models: Models) -> None:
    pushes = [push(0.4), push(0.5, (0.0, 0.0, -1.0), -3.0), push(0.6, (0.6, 0.8, 0.0), -2.8)]
    together = models.deformation(BODY, pushes)
    assert together.probability.shape == (3, 64, 64, 64)
    assert together.field.shape == (3, 3, 32, 32, 32)
    for i, one in enumerate(pushes):
        alone = models.deformation(BODY, [one])
        # Rounding decides which cell of the coarse solve's lattice a point on its border counts to.
        np.testing.assert_allclose(together.field[i], alone.field[0], atol=5e-4)
        # They are thirty times as far apart in voxels.
        np.testing.assert_allclose(together.probability[i], alone.probability[0], atol=0.07)


def test_probability_is_the_body_looked_up_through_the_displacement(models: Models) -> None:
    answer = models.deformation(BODY, [push()])
    np.testing.assert_array_equal(answer.probability[0], warp(BODY, answer.field[0]))


def test_the_body_moves_the_way_it_is_pushed(models: Models) -> None:
    for direction in ((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        answer = models.deformation(BODY, [push(direction=direction)])
        moved = displacement(answer.field[0])[:, answer.probability[0] > 0.5].mean(axis=1)
        assert moved @ direction > 0.5 * np.linalg.norm(moved) > 0.0


def test_the_body_stays_where_it_is_clamped(models: Models) -> None:
    answer = models.deformation(BODY, [push()])
    lengths = np.linalg.norm(displacement(answer.field[0]), axis=0)
    top = lengths[:, :, 36:44][BODY[:, :, 36:44]].mean()
    assert lengths[:, :, 0][BODY[:, :, 0]].mean() < 0.25 * top


def test_a_harder_push_moves_it_farther(models: Models) -> None:
    lengths = [
        np.linalg.norm(displacement(models.deformation(BODY, [push(log_load=load)]).field[0])[:, BODY], axis=0).mean()
        for load in (-4.0, -3.0, -2.3)
    ]
    assert lengths[0] < lengths[1] < lengths[2]
    assert lengths[0] < 0.2 * lengths[1]


def test_loads_of_several_materials_are_solved_each_with_its_own(models: Models) -> None:
    soft, stiff = push(), push()
    soft[7], stiff[7] = 0.0, 0.45
    both = models.deformation.prior(BODY, [soft, stiff, soft])
    alone = models.deformation.prior(BODY, [stiff])
    np.testing.assert_allclose(both.forward[1], alone.forward[0], atol=1e-6)
    np.testing.assert_array_equal(both.backward()[0], both.backward()[2])
    assert np.abs(both.forward[0] - both.forward[1]).max() > 1e-4


def test_a_body_asked_about_again_is_not_factorised_again(models: Models, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    class Counted(ElasticPrior):
        def __init__(self, rest: np.ndarray, poisson_ratio: float, spread: Spread) -> None:
            made.append(poisson_ratio)
            super().__init__(rest, poisson_ratio, spread=spread)

    monkeypatch.setattr("service.inference.bodies.ElasticPrior", Counted)
    body, other = BODY.copy(), BODY.copy()
    first = models.deformation.prior(body, [push()])
    again = models.deformation.prior(body, [push(0.6), push()])
    assert len(made) == 1
    np.testing.assert_allclose(again.forward[1], first.forward[0], atol=1e-4)
    softer = push()
    softer[7] = 0.1
    models.deformation.prior(body, [softer])
    models.deformation.prior(other, [softer])
    assert len(made) == 3


def test_a_body_asked_about_again_is_prepared_once(models: Models, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    class Counted(Warp):
        def __init__(self, rest: np.ndarray, inside: Inside | None = None) -> None:
            made.append(inside)
            super().__init__(rest, inside)

    monkeypatch.setattr("service.inference.bodies.Warp", Counted)
    body, inside = BODY.copy(), Inside(0.9 * BODY.astype(np.float32), probable=True)
    first, again = (models.deformation(body, [push()]) for _ in range(2))
    np.testing.assert_array_equal(first.probability, again.probability)
    assert made == [None]
    models.deformation(body, [push()], inside=inside)
    assert len(made) == 2


def test_a_body_asked_about_again_is_encoded_once(models: Models, monkeypatch: pytest.MonkeyPatch) -> None:
    encoder, runs = models.deformation._encoder, []

    class Counted:
        def run(self, names: list[str], feeds: dict[str, np.ndarray]) -> list[np.ndarray]:
            runs.append(feeds["rest"])
            return list(encoder.run(names, feeds))

    monkeypatch.setattr(models.deformation, "_encoder", Counted())
    body = BODY.copy()
    for conditions in ([push()], [push(0.6), push()]):
        models.deformation(body, conditions)
    (seen,) = runs
    np.testing.assert_array_equal(seen[0, 0], body)


@pytest.fixture(scope="module")
def shared(models_directory: Path) -> DeformationModel:
    """With a spare core, whether there is one or not."""
    return load_models(models_directory, threads=1, cores=2).deformation


@pytest.mark.parametrize("loads", [1, 2, 3])
def test_with_a_spare_core_answers_are_the_same(models: Models, shared: DeformationModel, loads: int) -> None:
    conditions = [push(0.4), push(0.5, (0.0, 0.0, -1.0), -3.0), push(0.6, (0.6, 0.8, 0.0), -2.8)][:loads]
    if loads == 3:
        conditions[1][7] = 0.1  # of another material
    body = BODY.copy()
    shared.prepare(body, 0.3)
    found, expected = shared(body, conditions), models.deformation(BODY, conditions)
    np.testing.assert_array_equal(found.field, expected.field)
    np.testing.assert_array_equal(found.probability, expected.probability)


def test_any_thread_may_ask(shared: DeformationModel) -> None:
    """More at once than there are cores, about more bodies than are kept, some about the same one."""
    bodies = []
    for height in range(20, 20 + 5 * (KEPT_BODIES + 1), 5):
        body = np.zeros_like(BODY)
        body[24:40, 20:44, :height] = True
        bodies.append(body)
    expected = [shared(body, [push()]) for body in bodies]
    with ThreadPoolExecutor(6) as threads:
        asked = [0, 0, *range(len(bodies)), 0]
        answers = list(threads.map(lambda i: shared(bodies[i], [push()]), asked))
    for i, answer in zip(asked, answers, strict=True):
        np.testing.assert_array_equal(answer.field, expected[i].field)
        np.testing.assert_array_equal(answer.probability, expected[i].probability)


def test_samples_of_the_latent_are_drawn_alike_each_time(models: Models) -> None:
    first, second = (models.deformation(BODY, [push(), push(0.6)], samples=3) for _ in range(2))
    np.testing.assert_array_equal(first.probability, second.probability)
    np.testing.assert_array_equal(first.field, second.field)


def test_samples_are_averaged(models: Models) -> None:
    (network,) = [graph for graph in models.graphs if graph.manifest.kind == "deformation"]
    (latent,) = [tensor.shape[1] for tensor in network.manifest.inputs if tensor.name == "noise"]
    draws = np.random.default_rng(0).standard_normal((2, latent)).astype(np.float32)
    prior = models.deformation.prior(BODY, [push()])
    inputs = {"rest": BODY.astype(np.float32)[None, None], "condition": push()[None], "prior": prior.forward}
    corrections = [network.run({**inputs, "noise": draw[None]})["correction"][0] for draw in draws]
    fields = [corrected(prior.backward()[0], correction, Warp(BODY).body) for correction in corrections]
    answer = models.deformation(BODY, [push()], samples=2)
    np.testing.assert_allclose(answer.field[0], np.mean(fields, axis=0), atol=1e-6)
    np.testing.assert_allclose(answer.probability[0], np.mean([warp(BODY, f) for f in fields], axis=0), atol=1e-6)


@pytest.mark.parametrize("field", [name for name in CONDITION_FIELDS if name != "log10_load_number"])
def test_a_condition_beyond_the_training_set_is_known(models: Models, field: str) -> None:
    ranges = models.deformation.manifest.condition_range
    inside = np.array([np.mean(ranges[name]) for name in CONDITION_FIELDS], np.float32)
    assert not models.deformation.outside_training_range(inside)
    column = CONDITION_FIELDS.index(field)
    for beyond in (ranges[field][0] - 0.01, ranges[field][1] + 0.01):
        outside = inside.copy()
        outside[column] = beyond
        assert models.deformation.outside_training_range(outside)


def test_a_gentle_push_is_within_the_training_set_and_a_violent_one_is_not(models: Models) -> None:
    ranges = models.deformation.manifest.condition_range
    condition = np.array([np.mean(ranges[name]) for name in CONDITION_FIELDS], np.float32)
    column = CONDITION_FIELDS.index("log10_load_number")
    condition[column] = ranges["log10_load_number"][0] - 3.0
    assert not models.deformation.outside_training_range(condition)
    condition[column] = ranges["log10_load_number"][1] + 0.01
    assert models.deformation.outside_training_range(condition)
