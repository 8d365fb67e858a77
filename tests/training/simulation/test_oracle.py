"""The simulator against scikit-fem, an independent finite element library, on its own meshes and elements."""

from functools import cache

import numpy as np
import pytest
import scipy.sparse as sp

from tests.training.simulation.bodies import ELEMENTS, box, bridge, column, union
from training.simulation.body import Body
from training.simulation.clamp import RigidClamp
from training.simulation.factor import factorise
from training.simulation.loads import self_weight
from training.simulation.material_law import lame
from training.simulation.mean_dilatation import MeanDilatationHexahedron
from training.simulation.solver import LinearSolver

skfem = pytest.importorskip("skfem", reason="scikit-fem is not installed (the `oracle` extra)")

T_SHAPE = union(box([0.5, 0.5, 0.25], [1 / 12, 2 / 12, 0.25]), box([0.5, 0.5, 7 / 12], [5 / 12, 2 / 12, 1 / 12]))
SHAPES = {"column": column(2 / 12, 8 / 12), "bridge": bridge(), "tee": T_SHAPE}


def skfem_displacement(distance, cells, element, poisson_ratio, weight):
    """Displacement of a body under its own weight, clamped at z = 0, axis by axis, and the basis of each.

    K_ia,jb = ∫ λ ∂_i φ_a ∂_j φ_b + μ ∂_j φ_a ∂_i φ_b + δ_ij μ ∇φ_a·∇φ_b of a scalar element: six forms on 27 functions
    where its vector element would take one on 81, twenty times as long.

    Source: Hughes (2000), eq. 2.7.34 to 2.7.36, for the components.
    """
    line = np.linspace(0.0, 1.0, cells + 1)
    mesh = skfem.MeshHex.init_tensor(line, line, line)
    centres = mesh.p[:, mesh.t].mean(axis=1).T
    mesh = mesh.restrict(np.flatnonzero(distance(centres.astype(np.float32)) < 0))
    mu, lam = lame(poisson_ratio)
    # three Gauss points an axis are exact for quadratic cubes; the default takes seven
    basis = skfem.Basis(mesh, element, intorder=4)

    def products(i, j):
        """∫ ∂_i φ_a ∂_j φ_b, rows a."""
        return skfem.BilinearForm(lambda u, v, _: u.grad[j] * v.grad[i]).assemble(basis)

    inner = {(i, j): products(i, j) for i in range(3) for j in range(i, 3)}
    inner |= {(j, i): matrix.T for (i, j), matrix in inner.items() if i < j}
    blocks = [[lam * inner[i, j] + mu * inner[j, i] for j in range(3)] for i in range(3)]
    for i in range(3):
        blocks[i][i] = blocks[i][i] + mu * (inner[0, 0] + inner[1, 1] + inner[2, 2])
    share = skfem.LinearForm(lambda v, _: 1.0 * v).assemble(basis)
    held = basis.get_dofs(lambda x: np.isclose(x[2], 0.0)).flatten()
    free = np.setdiff1d(np.arange(3 * basis.N), (held + basis.N * np.arange(3)[:, None]).ravel())
    matrix = sp.block_array(blocks, format="csr")[free][:, free]
    solution = np.zeros(3 * basis.N)
    # their matrix, our factor: SciPy's own takes minutes on quadratic elements
    upper = sp.csr_array(sp.triu(matrix, format="csr"))
    upper.sort_indices()
    solution[free] = factorise(upper).solve(np.outer(weight, share).ravel()[free, None])[:, 0]
    return solution.reshape(3, basis.N), basis


def at_vertices(solution, basis):
    order = np.lexsort(basis.mesh.p)
    return basis.mesh.p.T[order], solution[:, basis.nodal_dofs[0]].T[order]


@pytest.mark.parametrize("name", SHAPES)
def test_without_lateral_contraction_both_are_the_same_element(name):
    """At ν = 0 the λ part vanishes and the mean-dilatation element is the plain trilinear one: equal to 1e-9."""
    weight = np.array([0.3, 0.2, -1.0])
    body = Body.from_distance(SHAPES[name], 12, RigidClamp())
    ours = LinearSolver(body, 0.0, MeanDilatationHexahedron).solve_forces(self_weight(body, weight)[None])[0]
    theirs = skfem_displacement(SHAPES[name], 12, skfem.ElementHex1(), 0.0, weight)
    points, expected = at_vertices(*theirs)
    order = np.lexsort(body.node_positions.T)
    np.testing.assert_allclose(body.node_positions[order], points, atol=1e-12)
    np.testing.assert_allclose(ours[order], expected, atol=1e-9 * np.abs(expected).max())


def largest_error(ours, theirs, body):
    """Largest distance between the two solutions at the vertices they share, over the largest displacement."""
    points, expected = at_vertices(*theirs)
    cells = round(1.0 / np.diff(np.unique(points[:, 2])).min())
    shared = (body.node_grid % (body.cells // cells) == 0).all(axis=1)
    grid = body.node_positions[shared]
    order = np.lexsort(grid.T)
    np.testing.assert_allclose(grid[order], points, atol=1e-12)
    error = np.linalg.norm(ours[shared][order] - expected, axis=1).max()
    return error / np.linalg.norm(expected, axis=1).max()


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("name", SHAPES)
def test_displacements_agree_with_quadratic_elements(name, element):
    """Within 3 % of triquadratic hexahedra everywhere, with four cells to a member."""
    weight = np.array([1.0, 0.3, -0.5])
    body = Body.from_distance(SHAPES[name], 24, RigidClamp())
    ours = LinearSolver(body, 0.3, element).solve_forces(self_weight(body, weight)[None])[0]
    theirs = quadratic(name, 12, 0.3)
    assert largest_error(ours, theirs, body) < 0.03


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("name", ["column", pytest.param("bridge", marks=pytest.mark.slow)])
def test_nearly_incompressible_bodies_agree_with_quadratic_elements(name, element):
    """Within 3 % at ν = 0.49: no locking. Quadratic elements half as fine are off by 5 % themselves."""
    body = Body.from_distance(SHAPES[name], 24, RigidClamp())
    ours = LinearSolver(body, 0.49, element).solve_forces(self_weight(body, np.array([1.0, 0.3, -0.5]))[None])[0]
    assert largest_error(ours, quadratic(name, 24, 0.49), body) < 0.03


@cache
def quadratic(name, cells, poisson_ratio):
    return skfem_displacement(SHAPES[name], cells, skfem.ElementHex2(), poisson_ratio, np.array([1.0, 0.3, -0.5]))
