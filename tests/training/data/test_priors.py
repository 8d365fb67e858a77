from pathlib import Path

import numpy as np
import pytest

from service.core.prior import ElasticPrior
from tests.training import tiny
from training.data.batches import DeformationSet


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> DeformationSet:
    return DeformationSet.load(tiny.write_deformations(tmp_path_factory.mktemp("deformations")), "train")


def test_every_sample_comes_with_the_coarse_solve_of_its_body_and_load(samples: DeformationSet) -> None:
    batch = samples.batch(np.array([3, 0]))
    for i, row in enumerate((3, 0)):
        rest = batch.rest[i, 0].numpy() > 0.5
        answer = ElasticPrior(rest, float(samples.condition[row, 7])).displacements([samples.condition[row]])
        # Kept at half precision: eleven bits.
        scale = float(np.abs(answer.forward).max())
        assert scale > 0.01
        np.testing.assert_allclose(batch.prior_forward[i].numpy(), answer.forward[0], atol=1e-3 * scale)
        np.testing.assert_allclose(batch.prior_backward[i].numpy(), answer.backward[0], atol=1e-3 * scale)


def test_a_set_without_priors_holds_zeros(tmp_path: Path) -> None:
    batch = DeformationSet.load(tiny.write_deformations(tmp_path), "train", prior=False).batch(np.array([0]))
    assert not batch.prior_forward.any()
    assert batch.prior_backward.shape == (1, 3, 32, 32, 32)


def test_a_body_is_solved_once(samples: DeformationSet, monkeypatch: pytest.MonkeyPatch) -> None:
    samples.batch(np.arange(len(samples)))

    def forbidden(*_: object) -> None:
        raise AssertionError("solved again")

    monkeypatch.setattr("training.data.priors.ElasticPrior", forbidden)
    samples.batch(np.arange(len(samples)))
