from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import scipy.sparse as sp

from tests.training.simulation.bodies import ELEMENTS, bridge, column, full_stiffness, sphere
from training.simulation.body import Body
from training.simulation.clamp import Clamp, RigidClamp
from training.simulation.elements import shape_functions
from training.simulation.enhanced import EnhancedHexahedron
from training.simulation.loads import Load, nodal_forces
from training.simulation.material_law import lame
from training.simulation.mean_dilatation import MeanDilatationHexahedron
from training.simulation.solver import LinearSolver

DOWN = np.array([0.0, 0.0, -1.0])


@pytest.fixture(scope="module", params=[Clamp(), RigidClamp()], ids=["bed", "rigid"])
def solver(request):
    return LinearSolver(Body.from_distance(bridge(), 12, request.param), 0.3)


@pytest.mark.parametrize("clamp", [Clamp(), RigidClamp()])
def test_global_matrix_agrees_with_plain_assembly(clamp):
    body = Body.from_distance(sphere([0.5, 0.5, 0.25], 0.3), 10, clamp)
    solver = LinearSolver(body, 0.4)
    full = full_stiffness(body, 0.4) + sp.kron(body.foundation, np.eye(3))
    plain = full.tocsr()[body.free_dof][:, body.free_dof].toarray()
    np.testing.assert_allclose(np.triu(plain), solver.stiffness.toarray(), atol=1e-15)


def test_the_reaction_balances_the_load(solver):
    """Σ r = −F, Σ x × r = −Σ x × f, and K u = f wherever the clamp does nothing."""
    load = Load(np.array([0.5, 0.5, 8 / 12]), np.array([0.6, 0.0, -0.8]), 0.01)
    forces = nodal_forces(solver.body, load)
    displacement = solver.solve([load])[0]
    reaction = solver.reaction(displacement, forces)
    np.testing.assert_allclose(reaction.force, -0.01 * load.direction, atol=1e-12)
    np.testing.assert_allclose(reaction.moment, -np.cross(solver.body.node_positions, forces).sum(axis=0), atol=1e-12)
    above = solver.body.node_grid[:, 2] > 1
    np.testing.assert_allclose(solver.internal_forces(displacement)[above], forces[above], atol=1e-12)


def test_response_is_linear_in_the_load(solver):
    """Λ = F/(E L²): twice the Young's modulus at one force is half the load number, and half the displacement."""
    contact = np.array([0.4, 0.5, 8 / 12])
    one, half = solver.solve([Load(contact, DOWN, 0.01), Load(contact, DOWN, 0.005)])
    np.testing.assert_allclose(half, 0.5 * one, rtol=1e-12, atol=1e-17)


def test_mirrored_load_gives_the_mirrored_displacement(solver):
    body = solver.body
    one, other = solver.solve(
        [
            Load(np.array([0.35, 0.45, 8 / 12]), np.array([0.6, 0.0, -0.8]), 0.01),
            Load(np.array([0.65, 0.45, 8 / 12]), np.array([-0.6, 0.0, -0.8]), 0.01),
        ]
    )
    order = np.lexsort(body.node_grid.T)
    mirrored = np.lexsort((body.node_grid * [-1, 1, 1]).T)
    # contact and lattice are float32-rounded where the distance is taken
    np.testing.assert_allclose(one[order], (other * [-1, 1, 1])[mirrored], atol=1e-6 * np.abs(one).max())


def tip_deflection(cells_across: int, poisson_ratio: float, element=EnhancedHexahedron) -> float:
    """Mean lateral deflection of the end face of an upright beam, 6 times as long as thick, under unit end shear."""
    cells = 8 * cells_across
    body = Body.from_distance(column(1 / 8, 6 / 8), cells, RigidClamp())
    solver = LinearSolver(body, poisson_ratio, element)
    end = body.node_grid[:, 2] == 6 * cells_across
    x, y = body.node_positions[:, 0] - 0.5, body.node_positions[:, 1] - 0.5
    weight = np.where(np.isclose(np.abs(x), 1 / 16), 0.5, 1.0) * np.where(np.isclose(np.abs(y), 1 / 16), 0.5, 1.0) * end
    forces = np.zeros((1, body.nodes, 3))
    forces[0, :, 0] = weight / weight.sum()
    return float(solver.solve_forces(forces)[0, :, 0] @ weight / weight.sum())


def timoshenko(poisson_ratio: float) -> float:
    """P L³/(3 E I) + P L/(κ G A) with κ = 10(1+ν)/(12+11ν); Cowper, J. Appl. Mech. 33 (1966)."""
    thickness, length = 1 / 8, 6 / 8
    shear_coefficient = 10 * (1 + poisson_ratio) / (12 + 11 * poisson_ratio)
    bending = length**3 / (3 * thickness**4 / 12)
    return bending + length / (shear_coefficient * lame(poisson_ratio)[0] * thickness**2)


def test_cantilever_converges_to_timoshenko():
    """The plain cell climbs to it from below; the enhanced one is there with two cells in thickness."""
    plain = [tip_deflection(cells, 0.0, MeanDilatationHexahedron) / timoshenko(0.0) for cells in (2, 4, 6)]
    enhanced = [tip_deflection(cells, 0.0) / timoshenko(0.0) for cells in (2, 4, 6)]
    assert plain[0] < plain[1] < plain[2] < 1.0
    assert plain[1] == pytest.approx(1.0, abs=0.04)
    assert enhanced == pytest.approx([1.0, 1.0, 1.0], abs=0.005)
    # where the material contracts sideways the clamp, which the formula ignores, stiffens the beam a little
    assert tip_deflection(4, 0.3) == pytest.approx(timoshenko(0.3), rel=0.02)


@pytest.mark.parametrize("element", ELEMENTS)
def test_nearly_incompressible_cantilever_does_not_lock(element):
    """The clamp, which stops the section's contraction, stiffens this beam by 4 % however fine its cells."""
    assert tip_deflection(4, 0.49, element) == pytest.approx(0.963 * timoshenko(0.49), rel=0.03)


POKED_CELLS, POKED_RATIO = 20, 0.3


@cache
def half_space():
    """A cube, the nodes of its far faces, Boussinesq's displacements of a point load at the middle of its top, and its
    solver with those faces held: one factor for both discs."""
    body = Body.from_distance(lambda points: points[:, 2] - 1.0, POKED_CELLS, RigidClamp())
    mu, _ = lame(POKED_RATIO)
    offset = body.node_positions - [0.5, 0.5, 1.0]
    depth, flat = -offset[:, 2], np.hypot(offset[:, 0], offset[:, 1])
    distance = np.maximum(np.hypot(flat, depth), 1e-9)
    down = (2 * (1 - POKED_RATIO) / distance + depth**2 / distance**3) / (4 * np.pi * mu)
    outward = depth / distance**3 - (1 - 2 * POKED_RATIO) / (distance * (distance + depth))
    sideways = outward[:, None] / (4 * np.pi * mu) * offset[:, :2]
    boussinesq = np.concatenate([sideways, -down[:, None]], axis=1)
    sides = ((body.node_grid[:, :2] == 0) | (body.node_grid[:, :2] == POKED_CELLS)).any(axis=1)
    far = sides | (body.node_grid[:, 2] == 0)
    return body, far, boussinesq, LinearSolver(replace(body, clamped=far), POKED_RATIO)


@pytest.mark.parametrize(("uniform", "tolerance"), [(True, 0.10), (False, 0.10)])
def test_poke_of_a_half_space(uniform, tolerance):
    """Centre of a disc under pressure p: 2(1−ν²) p a/E if uniform, 2(1−ν²)/E ∫ p dr = 3.2 (1−ν²) F/(π E R) for ours.

    The body is a cube whose far faces are held at Boussinesq's displacements of a point load, which is what a half
    space would do there.

    Source: Johnson, Contact Mechanics (1985), eq. 3.18 (Boussinesq) and eq. 3.29a (disc).
    """
    poisson_ratio, cells, radius = POKED_RATIO, POKED_CELLS, 0.2
    body, far, boussinesq, solver = half_space()
    if uniform:
        fine = (np.arange(40 * cells) + 0.5) / (40 * cells)
        x, y = np.meshgrid(fine, fine, indexing="ij")
        loaded = (x - 0.5) ** 2 + (y - 0.5) ** 2 < radius**2
        points = np.stack([x[loaded], y[loaded], np.full(loaded.sum(), 1.0)], axis=1)
        cell, local = body.locate(points)
        share = np.bincount(body.cell_nodes[cell].ravel(), weights=shape_functions(local).ravel(), minlength=body.nodes)
        forces = share[:, None] / share.sum() * DOWN
        expected = 2 * (1 - poisson_ratio**2) / (np.pi * radius)
    else:
        forces = nodal_forces(body, Load(np.array([0.5, 0.5, 1.0]), DOWN, 1.0, radius))
        expected = 3.2 * (1 - poisson_ratio**2) / (np.pi * radius)
    fixed = np.repeat(far[:, None], 3, axis=1)
    imposed = solver.internal_forces(np.where(fixed, boussinesq, 0.0))
    found = solver.solve_forces((forces - imposed)[None])[0]
    centre = np.flatnonzero((body.node_grid == [cells // 2, cells // 2, cells]).all(axis=1))[0]
    assert -found[centre, 2] == pytest.approx(expected, rel=tolerance)
