"""Probes in displacement fields that are known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.training.simulation.cases import LENGTH_M, OFFSET_M, WIDTH_M, bar_case
from training.simulation.probe import Interpolation, ProbeOffBody, read_probe
from training.simulation.solved_case import SolvedCase, solve_case

ANGLE = 0.4
TURN = np.array([[np.cos(ANGLE), 0.0, np.sin(ANGLE)], [0.0, 1.0, 0.0], [-np.sin(ANGLE), 0.0, np.cos(ANGLE)]])


@pytest.fixture(scope="module")
def solved() -> SolvedCase:
    return solve_case(bar_case(gravity_m_s2=np.array([0.0, 0.0, -9.81]), law="linear"))


def moved_by(solved: SolvedCase, gradient: np.ndarray, law: str = "neo_hookean") -> SolvedCase:
    """The same body displaced by an affine field, which is zero at the origin of the file."""
    positions_m = solved.placement.to_metres(solved.body.node_positions)
    displacement = positions_m @ gradient.T / solved.placement.edge_m
    state = replace(solved.state, displacement=displacement)
    return replace(solved, steps=(state,), case=replace(solved.case, law=law))


@pytest.mark.parametrize(
    "offset",
    [[0.04, 0.01, 0.01], [0.0, 0.0, 0.0], [LENGTH_M, WIDTH_M, WIDTH_M], [0.033, 0.007, WIDTH_M], [0.05, 0.01, 0.02004]],
)
def test_an_affine_field_is_read_exactly_inside_and_on_the_surface(solved: SolvedCase, offset: list[float]) -> None:
    gradient = np.array([[0.1, 0.02, 0.0], [0.0, -0.05, 0.03], [0.04, 0.0, 0.06]])
    point_m = OFFSET_M + offset
    reading = read_probe(moved_by(solved, gradient), point_m)
    np.testing.assert_allclose(reading.displacement_m, gradient @ point_m, atol=1e-12)
    assert reading.stalk_m == 0.0


def test_a_marker_on_a_stalk_turns_with_the_surface(solved: SolvedCase) -> None:
    """A rotation moves the marker as a rigid body, however far it stands off."""
    point_m = OFFSET_M + np.array([0.05, 0.01, WIDTH_M + 0.006])
    reading = read_probe(moved_by(solved, TURN - np.eye(3)), point_m)
    np.testing.assert_allclose(reading.displacement_m, (TURN - np.eye(3)) @ point_m, atol=1e-9)
    assert reading.stalk_m == pytest.approx(0.006)


def test_a_stalk_does_not_stretch_with_the_surface(solved: SolvedCase) -> None:
    """F = R U: the foot moves by F, the stalk turns by R only."""
    gradient = TURN @ np.diag([1.2, 1.0, 0.9]) - np.eye(3)
    foot_m, stalk_m = OFFSET_M + np.array([0.05, 0.01, WIDTH_M]), np.array([0.0, 0.0, 0.006])
    reading = read_probe(moved_by(solved, gradient), foot_m + stalk_m)
    np.testing.assert_allclose(reading.displacement_m, gradient @ foot_m + (TURN - np.eye(3)) @ stalk_m, atol=1e-9)


def test_by_the_linear_law_a_stalk_turns_by_the_linear_rotation(solved: SolvedCase) -> None:
    spin = np.array([[0.0, 0.0, 0.3], [0.0, 0.0, 0.0], [-0.3, 0.0, 0.0]])
    point_m = OFFSET_M + np.array([0.05, 0.01, WIDTH_M + 0.006])
    reading = read_probe(moved_by(solved, spin + np.diag([0.1, 0.0, 0.0]), "linear"), point_m)
    foot_m = point_m - [0.0, 0.0, 0.006]
    expected = (spin + np.diag([0.1, 0.0, 0.0])) @ foot_m + spin @ [0.0, 0.0, 0.006]
    np.testing.assert_allclose(reading.displacement_m, expected, atol=1e-9)


def test_a_probe_far_off_is_refused_with_its_distance(solved: SolvedCase) -> None:
    with pytest.raises(ProbeOffBody, match=r"is 0\.03 m off the body") as caught:
        read_probe(solved, OFFSET_M + np.array([0.05, 0.01, WIDTH_M + 0.03]))
    assert caught.value.distance_m == pytest.approx(0.03)


def test_the_gradient_of_an_affine_field_is_its_matrix(solved: SolvedCase) -> None:
    gradient = np.random.default_rng(3).normal(0, 0.1, (3, 3))
    body = solved.body
    field = Interpolation(body, body.node_positions @ gradient.T)
    points = np.random.default_rng(4).uniform(0, 1, (20, 3))
    np.testing.assert_allclose(field.gradient(points), np.broadcast_to(gradient, (20, 3, 3)), atol=1e-12)
