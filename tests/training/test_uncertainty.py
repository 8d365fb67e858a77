import dataclasses

import numpy as np
import pytest
import torch

from tests.training import tiny
from training.data.batches import DeformationSet
from training.networks.deformation import DeformationNetwork
from training.uncertainty import displacement_spread, rank_correlation


class Doubting(DeformationNetwork):
    """Answers with the true shear times a factor, and doubts it by a share of the answer for each unit of noise."""

    def __init__(self, doubt: float) -> None:
        super().__init__(dataclasses.replace(tiny.DEFORMATION, prior=False))
        self.doubt = doubt

    def forward(self, rest, condition, noise, prior):
        heights = (torch.arange(16) + 0.5) / 16
        field = torch.zeros(len(condition), 3, 16, 16, 16)
        shear = 0.5 * tiny.SHEAR * 10.0 ** condition[:, 6]
        field[:, 0] = (shear * (1 + self.doubt * noise[:, 0]))[:, None, None, None] * heights
        latent = torch.zeros(len(condition), 3)
        return field, latent, latent


@pytest.fixture(scope="module")
def samples(tmp_path_factory: pytest.TempPathFactory) -> DeformationSet:
    return DeformationSet.load(tiny.write_deformations(tmp_path_factory.mktemp("deformations")), "test", prior=False)


def test_doubt_that_grows_with_the_answer_correlates_with_an_error_that_does(samples: DeformationSet) -> None:
    figures = displacement_spread(Doubting(0.1), samples, draws=16)
    assert figures["spread_correlation"] == pytest.approx(1.0)
    # A shear answers half its peak on average, and sixteen draws part by about a tenth of it.
    assert 0.02 < figures["displacement_spread"] < 0.1


def test_spread_is_proportional_to_the_noise_that_is_let_in(samples: DeformationSet) -> None:
    little, more = (displacement_spread(Doubting(doubt), samples, draws=16) for doubt in (0.05, 0.1))
    assert more["displacement_spread"] == pytest.approx(2 * little["displacement_spread"], rel=0.1)


def test_a_network_without_doubt_tells_nothing_of_its_error(samples: DeformationSet) -> None:
    figures = displacement_spread(Doubting(0.0), samples, draws=2)
    assert figures["displacement_spread"] == pytest.approx(0.0, abs=1e-6)


def test_the_correlation_is_of_ranks() -> None:
    a = np.array([1.0, 2.0, 3.0, 4.0])
    assert rank_correlation(a, np.exp(a)) == pytest.approx(1.0)
    assert rank_correlation(a, -(a**3)) == pytest.approx(-1.0)
    assert rank_correlation(a, np.array([1.0, 3.0, 2.0, 4.0])) == pytest.approx(0.8)  # 1 - 6·2 / (4·15)
    assert rank_correlation(a, np.ones(4)) == 0.0
