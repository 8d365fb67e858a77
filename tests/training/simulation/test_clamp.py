import numpy as np
import pytest

from tests.training.simulation.bodies import box, column, sphere, union
from training.simulation.body import Body, BodyError
from training.simulation.clamp import STIFFNESS, Bed, Clamp, RigidClamp, half_space
from training.simulation.clamp import box as box_region
from training.simulation.elements import shape_functions
from training.simulation.enhanced import EnhancedHexahedron
from training.simulation.loads import Load
from training.simulation.newton import solve_neo_hookean
from training.simulation.solver import LinearSolver


def pushed(distance, cells, clamp, top=0.6, direction=(1.0, 0.0, 0.0)):
    """Displacement a little below the top, along a push there."""
    body = Body.from_distance(distance, cells, clamp)
    direction = np.array(direction)
    load = Load(np.array([0.5, 0.5, top]), direction, 1.0, 0.12)
    displacement = LinearSolver(body, 0.3, EnhancedHexahedron).solve([load])[0]
    cell, local = body.locate(np.array([[0.5, 0.5, top - 0.03]]))
    return float((shape_functions(local) @ displacement[body.cell_nodes[cell[0]]])[0] @ direction)


def test_the_foot_of_a_flat_bottom_is_its_area():
    bed = Clamp(stiffness=3.0).bed(column(0.4, 0.5), 24)
    assert bed.stiffness.sum() == pytest.approx(3.0 * 0.16, rel=1e-3)
    np.testing.assert_allclose(bed.points[:, 2], 0.0, atol=1e-3)  # the lattice may stand out of the rim


def test_the_foot_of_a_ball_is_the_cap_below_the_reach():
    """π (2 r h − h²) seen from below, whatever the cells; the points lie on the sphere."""
    bed = Clamp(stiffness=1.0).bed(sphere([0.5, 0.5, 0.3], 0.3), 24)
    assert bed.stiffness.sum() == pytest.approx(np.pi * (2 * 0.3 * 0.01 - 0.01**2), rel=0.02)
    radius = np.linalg.norm(bed.points - [0.5, 0.5, 0.3], axis=1)
    np.testing.assert_allclose(radius, 0.3, atol=5e-4)


def test_the_bed_enters_the_body_by_its_area():
    """Σ_ab K_ab = κ A, and a rigid turn θ about the x axis costs ½ κ θ² ∫ y² dA = ½ κ θ² w⁴/12."""
    body = Body.from_distance(column(0.4, 0.5), 16, Clamp(stiffness=100.0))
    assert body.foundation.sum() == pytest.approx(100.0 * 0.16, rel=1e-3)
    lever = body.node_positions[:, 1] - 0.5
    assert lever @ (body.foundation @ lever) == pytest.approx(100.0 * 0.4**4 / 12, rel=2e-3)
    assert not body.clamped.any()


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 0.0, -1.0)])
def test_a_flat_bottom_stands_on_the_bed_as_on_rigid_nodes(direction):
    """The bed of a column 3 times as high as wide gives way by 3/(κ L) of its bending, less than 1 %."""
    found = [pushed(column(0.25, 0.75), 16, clamp, 0.75, direction) for clamp in (Clamp(), RigidClamp())]
    assert 1.0 < found[0] / found[1] < 1.01


def test_a_ball_stands_on_one_foot_whatever_the_cells():
    """Pushed sideways a ball turns about its foot: rigid nodes lose more than half of it from 32³ to 16³ cells."""
    bed, rigid = (
        [pushed(sphere([0.5, 0.5, 0.3], 0.3), cells, clamp) for cells in (16, 32)] for clamp in (Clamp(), RigidClamp())
    )
    assert bed[0] / bed[1] > 0.78
    assert rigid[0] / rigid[1] < 0.4


def test_a_beam_is_held_at_one_end_by_a_region():
    """Length 0.7, thickness 0.2, ν = 0.3: P l³/3EI + P l/(κ G A), κ = 10(1+ν)/(12+11ν); the bed adds 3 %."""
    beam = box([0.5, 0.5, 0.5], [0.35, 0.1, 0.1])
    clamp = Clamp(half_space(np.array([0.155, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])))
    body = Body.from_distance(beam, 20, clamp)
    weight = np.isclose(body.node_positions[:, 0], 0.85).astype(float)
    for axis in (1, 2):
        weight *= np.where(np.isclose(np.abs(body.node_positions[:, axis] - 0.5), 0.1), 0.5, 1.0)
    forces = (weight / weight.sum())[:, None] * np.array([0.0, 0.0, -1.0])
    solver = LinearSolver(body, 0.3, EnhancedHexahedron)
    displacement = solver.solve_forces(forces[None])[0]
    shear = 10 * 1.3 / (12 + 11 * 0.3) * 0.04 / 2.6
    expected = 0.7**3 / (3 * 0.2**4 / 12) + 0.7 / shear
    assert -(weight @ displacement[:, 2]) / weight.sum() == pytest.approx(expected, rel=0.03)
    reaction = solver.reaction(displacement, forces)
    np.testing.assert_allclose(reaction.force, [0.0, 0.0, 1.0], atol=1e-9)
    # about the middle of the held end the moment is the load times the length
    turn = reaction.moment - np.cross([0.15, 0.5, 0.5], reaction.force)
    np.testing.assert_allclose(turn, [0.0, -0.7, 0.0], atol=1e-9)


def test_a_held_body_follows_a_large_load():
    clamp = Clamp(box_region(np.array([0.0, 0.0, 0.0]), np.array([0.17, 1.0, 1.0])))
    body = Body.from_distance(box([0.5, 0.5, 0.5], [0.35, 0.1, 0.1]), 20, clamp)
    load = Load(np.array([0.8, 0.5, 0.6]), np.array([0.0, 0.0, -1.0]), 2e-4)
    step = solve_neo_hookean(LinearSolver(body, 0.3), load)[-1]
    assert step.converged
    np.testing.assert_allclose(step.reaction.force, [0.0, 0.0, 2e-4], atol=2e-8)


@pytest.mark.parametrize(
    ("shape", "clamp", "reason"),
    [
        (column(0.3, 0.6), Clamp(box_region(np.full(3, 0.8), np.full(3, 0.9))), "clamp_off_body"),
        (column(0.3, 0.6), Clamp(box_region(np.array([0.4, 0.4, 0.55]), np.array([0.4, 0.6, 0.65]))), "clamp_off_body"),
        (sphere([0.5, 0.5, 0.32], 0.3), Clamp(), "not_standing"),
        (union(column(0.2, 0.3), sphere([0.5, 0.5, 0.7], 0.15)), Clamp(), "disconnected"),
    ],
)
def test_what_holds_nothing_is_refused(shape, clamp, reason):
    with pytest.raises(BodyError) as caught:
        Body.from_distance(shape, 16, clamp)
    assert caught.value.reason == reason


def test_a_row_of_points_lets_a_body_turn():
    line = np.stack([np.linspace(0.3, 0.7, 20), np.full(20, 0.5), np.zeros(20)], axis=1)
    down = np.tile([0.0, 0.0, -1.0], (40, 1))
    assert not Bed(line, down[:20], np.ones(20)).holds
    assert not Bed(line[:0], down[:0], np.empty(0)).holds
    assert Bed(np.concatenate([line, line + np.array([0.0, 0.02, 0.0])]), down, np.ones(40)).holds


@pytest.mark.parametrize("end", [0.25, 0.2495, 0.24])
def test_an_end_a_hair_beyond_a_cell_is_held_and_loaded_all_the_same(end):
    """The sliver in the next cell holds too little to count; its surface belongs to the cell behind it."""
    beam = box([0.5, 0.5, 0.5], [0.5 - end, 0.1, 0.1])
    clamp = Clamp(half_space(np.array([end + 0.005, 0.0, 0.0]), np.array([1.0, 0.0, 0.0])))
    body = Body.from_distance(beam, 16, clamp)
    assert body.foundation.sum() > 0.95 * STIFFNESS * 0.04
    load = Load(np.array([1.0 - end, 0.5, 0.5]), np.array([1.0, 0.0, 0.0]), 1.0)
    solver = LinearSolver(body, 0.0, EnhancedHexahedron)
    (displacement,) = solver.solve([load])
    # a bar under F, E A = 0.04: F x / (E A) in the middle of its length, and of its section
    cell, local = body.locate(np.array([[0.5, 0.5, 0.5]]))
    moved = (shape_functions(local) @ displacement[body.cell_nodes[cell[0]]])[0, 0]
    assert moved == pytest.approx((0.5 - end) / 0.04, rel=0.05)
