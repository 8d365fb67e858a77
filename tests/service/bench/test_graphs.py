"""The bare parts of one question are those that a new frame needs."""

from __future__ import annotations

import pytest

from service.bench.graphs import BareGraphs
from service.bench.question import sample_question
from service.core.arrays import Occupancy
from service.core.spread import Spread
from service.inference import bodies
from service.settings import Settings


def test_both_networks_and_the_whole_prior_are_asked_again(monkeypatch: pytest.MonkeyPatch) -> None:
    prepared: list[float] = []

    class Counted(bodies.ElasticPrior):
        def __init__(self, occupancy: Occupancy, poisson_ratio: float, spread: Spread) -> None:
            prepared.append(poisson_ratio)
            super().__init__(occupancy, poisson_ratio, spread=spread)

    monkeypatch.setattr(bodies, "ElasticPrior", Counted)
    bare = BareGraphs(Settings(), sample_question())
    assert set(bare.names) == {"reconstruction", "deformation", "prior"}
    before = len(prepared)
    assert bare.time_ms("prior") > 0
    bare.time_ms("prior")
    assert len(prepared) == before + 2  # its factor is not one that was kept
    bare.time_ms("reconstruction")
    bare.time_ms("deformation")
    assert len(prepared) == before + 2
