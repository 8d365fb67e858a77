"""The simulator against NGSolve, a second independent finite element library, on tetrahedra of its own."""

import numpy as np
import pytest

from tests.training.simulation.bodies import box, union
from training.simulation.body import Body
from training.simulation.clamp import RigidClamp
from training.simulation.enhanced import EnhancedHexahedron
from training.simulation.loads import self_weight
from training.simulation.material_law import lame
from training.simulation.solver import LinearSolver

# its wheel needs netgen-occt 7.8.1 beside it and the system's OpenBLAS: docs/simulator.md
ngsolve = pytest.importorskip("ngsolve", reason="NGSolve does not import here", exc_type=ImportError)

WEIGHT = (1.0, 0.3, -0.5)
BRICKS = {
    "column": [((5, 5, 0), (7, 7, 8))],
    "bridge": [((2, 4, 0), (4, 8, 7)), ((8, 4, 0), (10, 8, 7)), ((2, 4, 6), (10, 8, 8))],
    "tee": [((5, 4, 0), (7, 8, 7)), ((1, 4, 6), (11, 8, 8))],
}
"""Low and high corners in twelfths; where bricks meet they overlap."""


def cubic_tetrahedra(bricks):
    """Displacement of a body under its own weight, built in at its foot: cubics on a mesh of 0.1 L, ν = 0.3."""
    from netgen.csg import CSGeometry, OrthoBrick, Pnt

    solids = [OrthoBrick(*(Pnt(*(coordinate / 12 for coordinate in corner)) for corner in brick)) for brick in bricks]
    solid = solids[0]
    for other in solids[1:]:
        solid = solid + other
    geometry = CSGeometry()
    geometry.Add(solid)
    mesh = ngsolve.Mesh(geometry.GenerateMesh(maxh=0.1))
    space = ngsolve.VectorH1(mesh, order=3)
    u, v = space.TnT()
    mu, lam = lame(0.3)

    def strain(w):
        return 0.5 * (ngsolve.Grad(w) + ngsolve.Grad(w).trans)

    form = ngsolve.BilinearForm(space, symmetric=True)
    form += (2 * mu * ngsolve.InnerProduct(strain(u), strain(v)) + lam * ngsolve.div(u) * ngsolve.div(v)) * ngsolve.dx
    # all faces of a brick share a name: the foot is held by its stiffness, a million times the material's
    form += 1e6 * ngsolve.IfPos(1e-9 - ngsolve.z, 1.0, 0.0) * u * v * ngsolve.ds
    load = ngsolve.LinearForm(ngsolve.CoefficientFunction(WEIGHT) * v * ngsolve.dx)
    form.Assemble()
    load.Assemble()
    solution = ngsolve.GridFunction(space)
    solution.vec.data = form.mat.Inverse(space.FreeDofs(), inverse="sparsecholesky") * load.vec
    return mesh, solution


@pytest.mark.parametrize("name", BRICKS)
def test_a_body_bends_as_with_cubic_tetrahedra(name):
    """Within 3 % of the largest displacement at all nodes inside, with four cells to a member."""
    mesh, solution = cubic_tetrahedra(BRICKS[name])
    shape = union(*(box((np.array(a) + b) / 24, (np.array(b) - a) / 24) for a, b in BRICKS[name]))
    body = Body.from_distance(shape, 24, RigidClamp())
    ours = LinearSolver(body, 0.3, EnhancedHexahedron).solve_forces(self_weight(body, np.array(WEIGHT))[None])[0]
    inside = np.flatnonzero(shape(body.node_positions.astype(np.float32)) < -0.01)
    theirs = np.array([solution(mesh(*body.node_positions[node])) for node in inside])
    error = np.linalg.norm(ours[inside] - theirs, axis=1).max() / np.linalg.norm(theirs, axis=1).max()
    print(f"{name}: {mesh.ne} tetrahedra, {error:.4f}")
    assert error < 0.03, error
