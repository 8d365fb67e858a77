from dataclasses import replace

import numpy as np
import pytest

from tests.training.simulation.bodies import ELEMENTS, column, whole_cube
from training.simulation import stress as stress_module
from training.simulation.body import Body
from training.simulation.clamp import RigidClamp
from training.simulation.loads import Load
from training.simulation.material_law import lame
from training.simulation.newton import follow_forces, solve_neo_hookean
from training.simulation.solver import LinearSolver
from training.simulation.stress import linear_von_mises, von_mises


@pytest.fixture(scope="module", params=ELEMENTS, ids=lambda element: element.__name__)
def cube(request):
    """A solver of a cube of 4³ cells and a solution of it, without load."""
    solver = LinearSolver(Body.from_distance(whole_cube, 4, RigidClamp()), 0.3, request.param)
    return solver, follow_forces(solver, np.zeros((solver.body.nodes, 3)), (1.0,))[0]


def test_uniaxial_tension_by_hooke(cube):
    """Under σ_zz alone the von Mises stress is |σ_zz| = E ε_zz."""
    solver, _ = cube
    strain = np.diag([-0.3, -0.3, 1.0]) * 0.01
    found = linear_von_mises(solver, solver.body.node_positions @ strain.T)
    np.testing.assert_allclose(found, 0.01, rtol=1e-12)


def test_simple_shear_of_a_neo_hookean_body(cube):
    """F = 1 + γ e_x⊗e_z: σ_xx − σ_zz = μ γ², σ_xz = μ γ, von Mises √(μ² γ⁴ + 3 μ² γ²).

    Source: Bonet and Wood (2008), section 6.4.3, example 6.5.
    """
    solver, solution = cube
    shear = 0.4
    gradient = np.zeros((3, 3))
    gradient[0, 2] = shear
    found = von_mises(solver, replace(solution, displacement=solver.body.node_positions @ gradient.T))
    mu, _ = lame(0.3)
    np.testing.assert_allclose(found, mu * np.sqrt(shear**4 + 3 * shear**2), rtol=1e-12)


def test_a_turned_body_is_free_of_stress_by_the_nonlinear_law_only(cube):
    solver, solution = cube
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = solver.body.node_positions @ (turn - np.eye(3)).T
    assert von_mises(solver, replace(solution, displacement=turned)).max() < 1e-14
    assert linear_von_mises(solver, turned).min() > 0.1


def test_a_pushed_column_carries_force_over_area():
    """Half-way up a column of 4 × 4 cells, under its axial load: σ = F/A, within 3 %."""
    body = Body.from_distance(column(0.25, 0.75), 16)
    solver = LinearSolver(body, 0.3)
    load = Load(np.array([0.5, 0.5, 0.75]), np.array([0.0, 0.0, -1.0]), 1e-4, 0.12)
    (solution,) = solve_neo_hookean(solver, load, (1.0,))
    middle = body.active[:, 2] == 5
    expected = 1e-4 / 0.25**2
    assert von_mises(solver, solution)[middle].mean() == pytest.approx(expected, rel=0.03)
    assert linear_von_mises(solver, solution.displacement)[middle].mean() == pytest.approx(expected, rel=0.03)


def test_a_cell_has_the_mean_over_its_material():
    """Cells half in a body: Gauss points without material do not count. Against the same in NumPy."""
    solver = LinearSolver(Body.from_distance(column(0.27, 0.71), 12), 0.2)
    weights = solver.element.weights
    assert ((weights == 0.0).any(axis=0) & (weights > 0.0).any(axis=0)).any()
    moved = 0.02 * np.random.default_rng(0).normal(size=(solver.body.nodes, 3))
    f = solver.element.deformation_gradient(solver.body.gather(moved)).reshape(8, 3, 3, -1)
    strain = 0.5 * (f + f.transpose(0, 2, 1, 3)) - np.eye(3)[None, :, :, None]
    deviator = strain - np.einsum("giim->gm", strain)[:, None, None] / 3.0 * np.eye(3)[None, :, :, None]
    equivalent = 2.0 * lame(0.2)[0] * np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2)))
    expected = (weights * equivalent).sum(axis=0) / np.maximum(weights.sum(axis=0), 1e-300)
    np.testing.assert_allclose(linear_von_mises(solver, moved), expected, rtol=1e-12)


@pytest.mark.parametrize("law", ["linear", "neo_hookean"])
def test_stress_straight_from_the_nodes_is_that_of_the_gradients(law):
    """Cells without internal parameters take another loop than those with: the same numbers."""
    solver = LinearSolver(Body.from_distance(column(0.27, 0.71), 12), 0.2)
    element, small = solver.element, law == "linear"
    moved = 0.001 * np.random.default_rng(0).normal(size=(solver.body.nodes, 3))
    expected = np.empty(element.cells)
    gradient = element.deformation_gradient(solver.body.gather(moved))
    stress_module._means(gradient, element.weights, element.mu, small, expected)
    found = stress_module._cell_means(solver, moved, None if small else np.zeros((0, element.cells)))
    np.testing.assert_allclose(found, expected, rtol=1e-9)
