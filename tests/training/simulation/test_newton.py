import numpy as np
import pytest

from tests.training.simulation.bodies import ELEMENTS, bridge, column, sphere
from training.simulation.body import Body
from training.simulation.clamp import RigidClamp
from training.simulation.loads import Load, nodal_forces
from training.simulation.newton import solve_neo_hookean
from training.simulation.solver import LinearSolver

TOP = np.array([0.5, 0.5, 8 / 12])


@pytest.fixture(scope="module", params=ELEMENTS, ids=lambda element: element.__name__)
def solver(request):
    return LinearSolver(Body.from_distance(bridge(), 12), 0.4, request.param)


def test_rigid_nodes_carry_the_reaction_too():
    body = Body.from_distance(bridge(), 12, RigidClamp())
    load = Load(TOP, np.array([0.6, 0.0, -0.8]), 0.0005)
    step = solve_neo_hookean(LinearSolver(body, 0.3), load, fractions=(1.0,), tolerance=1e-8)[-1]
    assert not step.displacement[body.clamped].any()
    np.testing.assert_allclose(step.reaction.force, -load.load_number * load.direction, atol=1e-9)


def test_small_loads_give_the_linear_answer(solver):
    load = Load(TOP, np.array([0.6, 0.0, -0.8]), 1e-7)
    linear = solver.solve([load])[0]
    (solution,) = solve_neo_hookean(solver, load, fractions=(1.0,), tolerance=1e-8)
    assert solution.converged
    np.testing.assert_allclose(solution.displacement, linear, atol=1e-4 * np.abs(linear).max())
    bed = 0.5 * (linear * (solver.body.foundation @ linear)).sum()
    work = 0.5 * (nodal_forces(solver.body, load) * linear).sum()
    assert solution.strain_energy == pytest.approx(work - bed, rel=1e-4)


def test_every_load_step_is_in_equilibrium_at_a_large_load(solver):
    """Internal forces equal the load at free nodes; their sum at clamped nodes is minus the load."""
    load = Load(TOP, np.array([0.6, 0.0, -0.8]), 0.0015)
    steps = solve_neo_hookean(solver, load, tolerance=1e-8)
    assert [step.reason for step in steps] == [None, None, None]
    assert [step.loads[0].load_number for step in steps] == pytest.approx([0.0005, 0.001, 0.0015])
    assert steps[-1].peak_displacement > 0.05
    body = solver.body
    for step in steps:
        element = solver.element.evaluate(body.gather(step.displacement), step.parameters)
        assert np.abs(element.internal_forces).max(initial=0.0) < 1e-8 * np.abs(element.forces).max()
        applied = nodal_forces(body, step.loads)
        held = body.clamp_forces(step.displacement, body.scatter(element.forces) - applied)
        assert np.linalg.norm(body.scatter(element.forces) - applied - held) < 1e-8 * np.linalg.norm(applied)
        np.testing.assert_allclose(step.reaction.force, -step.loads[0].load_number * load.direction, atol=1e-9)
        moved = body.node_positions + step.displacement
        np.testing.assert_allclose(step.reaction.moment, -np.cross(moved, applied).sum(axis=0), atol=1e-9)
        assert step.strain_energy == pytest.approx(element.energy.sum())


def test_a_looser_tolerance_moves_nothing_by_a_hundredth_of_a_voxel(solver):
    load = Load(TOP, np.array([1.0, 0.0, 0.0]), 0.001)
    loose = solve_neo_hookean(solver, load)[-1]
    tight = solve_neo_hookean(solver, load, tolerance=1e-9)[-1]
    assert loose.converged and tight.converged
    assert np.abs(loose.displacement - tight.displacement).max() < 0.01 / 64


def test_a_bent_column_keeps_its_length_where_the_linear_one_grows():
    """Bending is nearly inextensible: the end of a slender beam follows an arc, while the linear one moves sideways."""
    body = Body.from_distance(column(1 / 6, 0.75), 24)
    solver = LinearSolver(body, 0.3)
    load = Load(np.array([0.5 + 1 / 12, 0.5, 0.7]), np.array([1.0, 0.0, 0.0]), 2e-4)
    linear = solver.solve([load])[0]
    solution = solve_neo_hookean(solver, load)[-1]
    assert solution.converged
    axis = np.flatnonzero((body.node_grid[:, :2] == 12).all(axis=1))
    axis = axis[np.argsort(body.node_grid[axis, 2])]

    def length(displacement):
        return np.linalg.norm(np.diff((body.node_positions + displacement)[axis], axis=0), axis=1).sum()

    assert length(linear) > 1.01 * 0.75
    assert length(solution.displacement) == pytest.approx(0.75, rel=0.005)


def test_a_crushing_load_is_reported_not_returned_as_converged():
    solver = LinearSolver(Body.from_distance(sphere([0.5, 0.5, 0.28], 0.3), 12), 0.2)
    steps = solve_neo_hookean(solver, Load(np.array([0.5, 0.5, 0.58]), np.array([0.0, 0.0, -1.0]), 0.5))
    assert not steps[-1].converged
    assert steps[-1].reason in {"inverted", "not_converged"}
    assert all(step.converged for step in steps[:-1])


def test_leaving_the_cube_is_reported():
    solver = LinearSolver(Body.from_distance(column(1 / 6, 0.9), 12), 0.3)
    load = Load(np.array([0.5, 0.5, 0.9]), np.array([0.0, 0.0, 1.0]), 0.02)
    assert solve_neo_hookean(solver, load, fractions=(1.0,))[-1].reason == "left_cube"


def test_a_pinch_is_the_work_of_both_loads(solver):
    """Two loads act together: equal and opposite ones leave nothing to the clamp, and at small size they add up."""
    left = Load(np.array([2 / 12, 0.5, 0.45]), np.array([1.0, 0.0, 0.0]), 0.002, 0.12)
    right = Load(np.array([10 / 12, 0.5, 0.45]), np.array([-1.0, 0.0, 0.0]), 0.002, 0.12)
    both, one, other = solver.solve([[left, right], left, right])
    np.testing.assert_allclose(both, one + other, atol=1e-12 * np.abs(one).max())
    step = solve_neo_hookean(solver, [left, right], (0.5,), tolerance=1e-8)[-1]
    assert step.converged
    assert [load.load_number for load in step.loads] == [0.001, 0.001]
    np.testing.assert_allclose(step.reaction.force, 0.0, atol=1e-9)


def test_the_convergence_record_ends_at_the_residual(solver):
    step = solve_neo_hookean(solver, Load(TOP, np.array([1.0, 0.0, 0.0]), 0.001), (1.0,))[-1]
    assert len(step.residuals) == step.iterations + 1 > 1
    assert step.residuals[-1] == step.residual < 1e-4 < step.residuals[0]
