"""The simulator against scikit-fem, an independent finite element library, on its own meshes and elements."""

import numpy as np
import pytest

from tests.training.simulation.bodies import box, bridge, column, union
from training.simulation.body import Body
from training.simulation.loads import self_weight
from training.simulation.material_law import lame
from training.simulation.solver import LinearSolver

skfem = pytest.importorskip("skfem", reason="scikit-fem is not installed (the `oracle` extra)")

T_SHAPE = union(box([0.5, 0.5, 0.25], [1 / 12, 2 / 12, 0.25]), box([0.5, 0.5, 7 / 12], [5 / 12, 2 / 12, 1 / 12]))
SHAPES = {"column": column(2 / 12, 8 / 12), "bridge": bridge(), "tee": T_SHAPE}


def skfem_displacement(distance, cells, element, poisson_ratio, weight):
    """Displacement of a body under its own weight, clamped at z = 0, and its mesh."""
    from skfem.helpers import dot
    from skfem.models.elasticity import linear_elasticity

    line = np.linspace(0.0, 1.0, cells + 1)
    mesh = skfem.MeshHex.init_tensor(line, line, line)
    centres = mesh.p[:, mesh.t].mean(axis=1).T
    mesh = mesh.restrict(np.flatnonzero(distance(centres.astype(np.float32)) < 0))
    mu, lam = lame(poisson_ratio)
    basis = skfem.Basis(mesh, skfem.ElementVector(element))
    stiffness = linear_elasticity(lam, mu).assemble(basis)
    vector = np.asarray(weight)
    load = skfem.LinearForm(lambda v, w: dot(np.broadcast_to(vector[:, None, None], v.shape), v)).assemble(basis)
    held = basis.get_dofs(lambda x: np.isclose(x[2], 0.0))
    return skfem.solve(*skfem.condense(stiffness, load, D=held)), basis


def at_vertices(solution, basis):
    order = np.lexsort(basis.mesh.p)
    return basis.mesh.p.T[order], solution[basis.nodal_dofs.T][order][:, :3]


@pytest.mark.parametrize("name", SHAPES)
def test_without_lateral_contraction_both_are_the_same_element(name):
    """At ν = 0 the λ part vanishes and the mean-dilatation element is the plain trilinear one: equal to 1e-9."""
    weight = np.array([0.3, 0.2, -1.0])
    body = Body.from_distance(SHAPES[name], 12)
    ours = LinearSolver(body, 0.0).solve_forces(self_weight(body, weight)[None])[0]
    theirs = skfem_displacement(SHAPES[name], 12, skfem.ElementHex1(), 0.0, weight)
    points, expected = at_vertices(*theirs)
    order = np.lexsort(body.node_positions.T)
    np.testing.assert_allclose(body.node_positions[order], points, atol=1e-12)
    np.testing.assert_allclose(ours[order], expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.49])
@pytest.mark.parametrize("name", SHAPES)
def test_peak_displacement_agrees_with_quadratic_elements(name, poisson_ratio):
    """Within 5 % of triquadratic hexahedra at four cells a member, also nearly incompressible: no locking."""
    weight = np.array([1.0, 0.3, -0.5])
    body = Body.from_distance(SHAPES[name], 24)
    ours = LinearSolver(body, poisson_ratio).solve_forces(self_weight(body, weight)[None])[0]
    theirs = skfem_displacement(SHAPES[name], 12, skfem.ElementHex2(), poisson_ratio, weight)
    points, expected = at_vertices(*theirs)
    shared = (body.node_grid % 2 == 0).all(axis=1)
    grid = body.node_positions[shared]
    order = np.lexsort(grid.T)
    np.testing.assert_allclose(grid[order], points, atol=1e-12)
    error = np.linalg.norm(ours[shared][order] - expected, axis=1).max()
    assert error < 0.05 * np.linalg.norm(expected, axis=1).max()
