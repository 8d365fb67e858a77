"""Beams against the elastica and against themselves."""

import numpy as np
import pytest

from training.experiments import plane_frame
from training.experiments.plane_frame import PlaneFrame


def cantilever(count: int = 20) -> PlaneFrame:
    """Of unit length and bending stiffness, along x, that hardly stretches."""
    nodes = np.stack([np.linspace(0.0, 1.0, count + 1), np.zeros(count + 1)], axis=1)
    first = np.arange(count)
    return PlaneFrame(nodes, first, first + 1, np.ones(count), np.full(count, 1e5), clamped=[0])


def at_tip(*components: float) -> np.ndarray:
    force = np.zeros((21, 3))
    force[-1] = components
    return force


def test_a_dead_force_bends_a_cantilever_as_the_elastica_says() -> None:
    """Deflection 0.30172 and 0.81061, drawn in by 0.05643 and 0.55500 at F L²/(E I) = 1 and 10.

    Source: Mattiasson, IJNME 17 (1981), table I.
    """
    states = cantilever().follow(at_tip(0.0, 1.0, 0.0), np.linspace(1.0, 10.0, 10))
    np.testing.assert_allclose(states[0, -1, :2], [-0.05643, 0.30172], atol=1e-3)
    np.testing.assert_allclose(states[-1, -1, :2], [-0.55500, 0.81061], atol=1e-3)


def test_a_moment_bends_it_to_a_circle() -> None:
    """κ = M/(E I): under a moment of 3 the tip has gone round 3 rad of a circle of radius 1/3."""
    states = cantilever().follow(at_tip(0.0, 0.0, 3.0), np.linspace(0.1, 1.0, 10))
    np.testing.assert_allclose(states[-1, -1], [np.sin(3.0) / 3 - 1, (1 - np.cos(3.0)) / 3, 3.0], atol=1e-3)


def test_the_tangent_is_the_derivative_of_the_forces() -> None:
    frame = cantilever(3)
    motion = 0.3 * np.random.default_rng(0).standard_normal((4, 3))
    _, tangent = frame.balance(motion)
    for dof in range(12):
        step = np.zeros(12)
        step[dof] = 1e-6
        up, down = (frame.balance(motion + sign * step.reshape(4, 3))[0] for sign in (1, -1))
        np.testing.assert_allclose((up - down) / 2e-6, tangent[:, dof], rtol=1e-4, atol=1e-3)


def test_turning_the_whole_frame_strains_nothing() -> None:
    frame = cantilever(5)
    angle = 2.5
    turned = frame.nodes @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    motion = np.concatenate([turned - frame.nodes, np.full((6, 1), angle)], axis=1)
    assert np.abs(frame.balance(motion)[0]).max() == pytest.approx(0.0, abs=1e-8)


def test_a_load_without_an_answer_repeats_the_state_before(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(plane_frame, "MAX_ITERATIONS", 1)
    states = cantilever().follow(at_tip(0.0, 1.0, 0.0), np.array([1.0, 20.0]))
    assert np.abs(states[0]).max() > 0.1
    np.testing.assert_array_equal(states[0], states[1])
