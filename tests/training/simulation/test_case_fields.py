"""Stress and volume ratio of cells, in states where both are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.training.simulation.cases import RUBBER, bar_case
from training.simulation.case_fields import cell_fields
from training.simulation.solved_case import SolvedCase, solve_case


@pytest.fixture(scope="module", params=["enhanced", "mean_dilatation"])
def solved(request: pytest.FixtureRequest) -> SolvedCase:
    return solve_case(bar_case(gravity_m_s2=np.array([0.0, 0.0, -9.81]), law="linear", element=request.param))


def strained(solved: SolvedCase, gradient: np.ndarray, law: str) -> SolvedCase:
    """The same body with an affine displacement."""
    state = replace(
        solved.state,
        displacement=solved.body.node_positions @ gradient.T,
        parameters=np.zeros_like(solved.state.parameters),
    )
    return replace(solved, steps=(state,), case=replace(solved.case, law=law))


@pytest.mark.parametrize(
    ("strain", "stress_pa"),
    [
        # σ_vM of pure shear γ: √3 μ γ; of uniaxial strain ε: 2 μ ε; of equal strains: none
        ([[0, 1e-3, 0], [0, 0, 0], [0, 0, 0]], 3**0.5 * 1e6 / 2.6 * 1e-3),
        ([[1e-3, 0, 0], [0, 0, 0], [0, 0, 0]], 2 * 1e6 / 2.6 * 1e-3),
        ([[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, 1e-3]], 0.0),
    ],
)
@pytest.mark.parametrize("law", ["linear", "neo_hookean"])
def test_small_strains(solved: SolvedCase, strain: list[list[float]], stress_pa: float, law: str) -> None:
    von_mises, jacobian = cell_fields(strained(solved, np.array(strain, np.float64), law))
    np.testing.assert_allclose(von_mises, stress_pa, rtol=3e-3, atol=1e-6)
    np.testing.assert_allclose(jacobian, np.linalg.det(np.eye(3) + strain), rtol=1e-9)


def test_a_finite_stretch(solved: SolvedCase) -> None:
    """F = diag(a, b, b): σ_vM = μ/J |a² − b²|, by neo-Hooke; the rotation that follows changes nothing.

    Source: Bonet and Wood (2008), eq. 6.28.
    """
    a, b, angle = 1.4, 0.9, 0.7
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    gradient = turn @ np.diag([a, b, b]) - np.eye(3)
    von_mises, jacobian = cell_fields(strained(solved, gradient, "neo_hookean"))
    mu_pa = RUBBER.young_modulus_pa / (2 * 1.3)
    np.testing.assert_allclose(von_mises, mu_pa / (a * b * b) * (a * a - b * b), rtol=1e-9)
    np.testing.assert_allclose(jacobian, a * b * b, rtol=1e-9)
