"""Load cases in SI: against formulas, against themselves elsewhere and in other units, and what does not fit."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.training.simulation.cases import LENGTH_M, OFFSET_M, RUBBER, WIDTH_M, bar_case, bar_triangles, below
from training.simulation.case import (
    CaseWarning,
    ContactOffSurface,
    NotConverged,
    NotHeld,
    PatchForce,
)
from training.simulation.placement import Box
from training.simulation.probe import read_probe
from training.simulation.solved_case import SolvedCase, solve_case

TOP_OF_TIP = OFFSET_M + np.array([LENGTH_M - 0.01, WIDTH_M / 2, WIDTH_M])


def hanging(**changes) -> SolvedCase:
    """The bar pulled along its axis by its own weight, a hundred times as strong."""
    return solve_case(bar_case(gravity_m_s2=np.array([981.0, 0.0, 0.0]), **changes))


def test_a_hanging_bar_stretches_by_its_weight() -> None:
    """Tip: ρ g ℓ²/2E; half-way: three quarters of it. ν = 0, so that the held end adds nothing.

    The bed under the held end gives by ρ g ℓ/κ, κ = 1e4 E/L: 0.03 % more at the tip.

    Source: Timoshenko and Goodier, Theory of Elasticity (1970), section 102.
    """
    material = replace(RUBBER, poisson_ratio=0.0)
    solved = hanging(material=material, law="linear")
    tip_m = 1000.0 * 981.0 * LENGTH_M**2 / (2 * 1e6)
    for part, share in ((1.0, 1.0), (0.5, 0.75)):
        moved_m = read_probe(solved, OFFSET_M + np.array([part * LENGTH_M, WIDTH_M / 2, WIDTH_M / 2])).displacement_m
        assert moved_m[0] == pytest.approx(share * tip_m, rel=5e-3)
        assert np.abs(moved_m[1:]).max() < 1e-6 * tip_m
    assert solved.state.strain_energy * 1e6 * solved.placement.edge_m**3 == pytest.approx(
        # ∫ σ²/2E dV with σ = ρ g (ℓ − x)
        (1000.0 * 981.0) ** 2 * LENGTH_M**3 * WIDTH_M**2 / (6 * 1e6),
        rel=1e-2,
    )


def test_the_clamp_carries_all_that_acts() -> None:
    """Two forces and the own weight, with opposite sign; rounded edges cost the weight a few thousandths."""
    forces = (
        PatchForce(TOP_OF_TIP, np.array([0.0, 0.0, -0.4])),
        PatchForce(OFFSET_M + np.array([0.05, 0.0, 0.01]), np.array([0.1, 0.2, 0.0]), 0.015),
    )
    solved = solve_case(bar_case(forces=forces, gravity_m_s2=np.array([0.0, 0.0, -9.81])))
    weight_n = 1000.0 * 9.81 * LENGTH_M * WIDTH_M**2
    expected = np.array([0.1, 0.2, -0.4 - weight_n])
    loads_n = solved.loads_n.sum(axis=0)
    np.testing.assert_allclose(loads_n[:2], expected[:2], rtol=1e-6)
    assert loads_n[2] == pytest.approx(expected[2], abs=5e-3 * weight_n)
    # 1e-4 of the load is what a step may leave unbalanced
    np.testing.assert_allclose(solved.reactions_n.sum(axis=0), -loads_n, atol=2e-4 * np.linalg.norm(expected))
    assert [step.fraction for step in solved.steps] == pytest.approx([1 / 3, 2 / 3, 1.0])


@pytest.mark.parametrize("law", ["linear", "neo_hookean"])
def test_the_answer_does_not_depend_on_axis_and_place(law: str) -> None:
    """The same bar along x and along y, elsewhere: cells, clamp, patch and load turn with it."""
    turned = np.roll(np.eye(3), 1, axis=0)  # x → y → z → x
    tips = []
    for rotation, shift in ((np.eye(3), np.zeros(3)), (turned, np.array([3.0, -2.0, 0.5]))):
        axis = int(np.argmax(rotation @ [1.0, 0.0, 0.0]))
        held = below(axis, float((rotation @ OFFSET_M + shift)[axis]))
        case = bar_case(
            triangles_m=bar_triangles() @ rotation.T + shift,
            clamps=(held,),
            forces=(PatchForce(rotation @ TOP_OF_TIP + shift, rotation @ [0.0, 0.0, -0.2]),),
            law=law,
        )
        tips.append(rotation.T @ read_probe(solve_case(case), rotation @ TOP_OF_TIP + shift).displacement_m)
    assert tips[0][2] < -1e-3
    np.testing.assert_allclose(tips[1], tips[0], atol=2e-3 * np.abs(tips[0]).max())


def test_what_stands_on_the_ground_is_held_there() -> None:
    """A column under its own weight, upright: only its foot is held, and its top sinks by about ρ g ℓ²/2E."""
    case = bar_case(axis=2, clamps=(), gravity_m_s2=np.array([0.0, 0.0, -98.1]), law="linear")
    solved = solve_case(case)
    sunk_m = -read_probe(solved, OFFSET_M + np.array([WIDTH_M / 2, WIDTH_M / 2, LENGTH_M])).displacement_m[2]
    assert sunk_m == pytest.approx(1000.0 * 98.1 * LENGTH_M**2 / (2 * 1e6), rel=0.05)
    foot_m = read_probe(solved, OFFSET_M + np.array([WIDTH_M / 2, WIDTH_M / 2, 0.0])).displacement_m
    assert np.linalg.norm(foot_m) < 0.02 * sunk_m


@pytest.mark.parametrize("element", ["enhanced", "mean_dilatation"])
def test_small_loads_bend_alike_by_both_laws(element: str) -> None:
    moved = []
    for law in ("linear", "neo_hookean"):
        case = bar_case(forces=(PatchForce(TOP_OF_TIP, np.array([0.0, 0.0, -1e-4])),), law=law, element=element)
        solved = solve_case(case)
        moved.append(read_probe(solved, TOP_OF_TIP).displacement_m)
        assert solved.steps[-1].residual < 1e-4
    np.testing.assert_allclose(moved[1], moved[0], atol=1e-3 * np.abs(moved[0]).max())


def test_a_contact_off_the_surface_is_refused_with_its_distance() -> None:
    force = PatchForce(TOP_OF_TIP + np.array([0.0, 0.0, 0.005]), np.array([0.0, 0.0, -0.1]))
    with pytest.raises(ContactOffSurface, match=r"load 1 lies 0\.005 m off the surface") as caught:
        solve_case(bar_case(forces=(force,)))
    assert caught.value.distance_m == pytest.approx(0.005)


def test_a_contact_a_hair_off_the_surface_is_put_on_it() -> None:
    moved = []
    for gap_m in (0.0, 0.001):
        force = PatchForce(TOP_OF_TIP + np.array([0.0, 0.0, gap_m]), np.array([0.0, 0.0, -0.1]))
        moved.append(read_probe(solve_case(bar_case(forces=(force,), law="linear")), TOP_OF_TIP).displacement_m)
    np.testing.assert_array_equal(moved[0], moved[1])


def test_a_clamp_that_misses_the_body() -> None:
    far = Box(OFFSET_M + 1.0, OFFSET_M + 2.0)
    with pytest.raises(NotHeld, match=r"the body spans \[0\.31, -0\.27, 1\.04\]"):
        hanging(clamps=(far,))


def test_a_body_of_two_pieces_of_which_one_is_held() -> None:
    pieces = np.concatenate([bar_triangles(), bar_triangles() + np.array([0.0, 0.06, 0.0])])
    with pytest.raises(NotHeld, match="50% of the shape is not connected"):
        hanging(triangles_m=pieces, clamps=(Box(OFFSET_M - 0.001, OFFSET_M + np.array([0.01, 0.021, 0.021])),))


def test_thin_members_are_warned_of_with_what_they_need() -> None:
    plate = np.asarray(trimesh.creation.box((0.1, 0.1, 0.008)).triangles, np.float64)
    with pytest.warns(
        CaseWarning, match=r"measures 0\.00[789]\d* m, 1\.\d cells of 0\.00625 m; .*: [34]\d cells an edge"
    ):
        solved = solve_case(
            bar_case(
                triangles_m=plate,
                clamps=(below(0, -0.045),),
                cells=21,
                fill=0.76,
                gravity_m_s2=np.array([0.0, 0.0, -9.81]),
                law="linear",
            )
        )
    assert solved.thickness_m == pytest.approx(0.008, abs=0.0015)


def test_a_small_patch_is_warned_of() -> None:
    force = PatchForce(TOP_OF_TIP, np.array([0.0, 0.0, -0.01]), 0.004)
    with pytest.warns(CaseWarning, match=r"load 1 has a radius of 0\.004 m, less than two cells of 0\.00667 m"):
        solve_case(bar_case(forces=(force,), law="linear"))


def test_what_is_crushed_is_not_an_answer() -> None:
    force = PatchForce(TOP_OF_TIP, np.array([0.0, 0.0, -500.0]))
    with pytest.raises(NotConverged, match="of the load") as caught:
        solve_case(bar_case(forces=(force,), load_steps=1))
    assert not caught.value.solution.converged


def test_what_leaves_the_cube_asks_for_room() -> None:
    case = bar_case(gravity_m_s2=np.array([0.0, 0.0, -60.0]), cells=12, fill=0.92, load_steps=2)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CaseWarning)
        with pytest.raises(NotConverged, match=r"leaves the simulated cube at \d+% of the load: .* fill of 0\.92"):
            solve_case(case)
        assert solve_case(replace(case, fill=0.5)).steps[-1].fraction == 1.0
