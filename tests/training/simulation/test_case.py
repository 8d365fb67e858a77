"""Numbers that make no load case."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.training.simulation.cases import LENGTH_M, OFFSET_M, RUBBER, bar_case
from training.simulation.case import (
    BadMaterial,
    CaseError,
    CaseWarning,
    Material,
    NothingActs,
    PatchForce,
    simulated_poisson_ratio,
)

TIP = OFFSET_M + np.array([LENGTH_M, 0.0, 0.0])


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"young_modulus_pa": 0.0}, "Young's modulus is 0 Pa"),
        ({"young_modulus_pa": float("nan")}, "Young's modulus"),
        ({"poisson_ratio": 0.6}, "Poisson's ratio is 0.6"),
        ({"poisson_ratio": -0.1}, "0 to 0.5"),
        ({"density_kg_m3": -1.0}, "density is -1"),
    ],
)
def test_impossible_materials(changes: dict[str, float], words: str) -> None:
    with pytest.raises(BadMaterial, match=words):
        simulated_poisson_ratio(bar_case(material=replace(RUBBER, **changes)))


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"cells": 3}, "3 cells"),
        ({"cells": 200}, "4 to 96"),
        ({"fill": 1.0}, "fill 1"),
        ({"load_steps": 0}, "0 load steps"),
    ],
)
def test_impossible_grids(changes: dict[str, float], words: str) -> None:
    with pytest.raises(CaseError, match=words):
        simulated_poisson_ratio(bar_case(**changes))


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"gravity_m_s2": np.zeros(3)},
        {"material": Material(1e6, 0.3), "gravity_m_s2": np.array([0.0, 0.0, -9.81])},
        {"forces": (PatchForce(TIP, np.zeros(3)),)},
    ],
)
def test_nothing_acts(changes: dict) -> None:
    with pytest.raises(NothingActs, match="give a load, or a density"):
        simulated_poisson_ratio(bar_case(**changes))


def test_poissons_ratio_of_a_half_is_simulated_just_below() -> None:
    case = bar_case(material=replace(RUBBER, poisson_ratio=0.499), gravity_m_s2=np.array([0.0, 0.0, -9.81]))
    with pytest.warns(CaseWarning, match="Poisson's ratio 0.499 is solved as 0.49"):
        assert simulated_poisson_ratio(case) == 0.49
