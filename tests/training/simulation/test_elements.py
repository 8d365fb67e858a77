import numpy as np
import pytest

from tests.training.simulation.bodies import (
    ELEMENTS,
    at_rest,
    full_stiffness,
    on_boundary,
    solve_dirichlet,
    whole_cube,
)
from training.simulation.body import Body
from training.simulation.elements import CORNERS, PAIRS_24, shape_functions, shape_gradients
from training.simulation.material_law import lame

EDGE = 0.5
FULL = np.ones((8, 1))


def unpack(upper):
    full = np.zeros((24, 24, upper.shape[1]))
    full[PAIRS_24] = upper
    full[PAIRS_24[1], PAIRS_24[0]] = upper
    return full


def affine(gradient):
    """Element displacements of u = G X on one cell."""
    return (EDGE * CORNERS @ gradient.T).reshape(24, 1)


@pytest.fixture(params=ELEMENTS, ids=lambda element: element.__name__)
def kind(request):
    return request.param


@pytest.fixture
def displacement():
    return 0.015 * np.random.default_rng(7).normal(size=(24, 5))


@pytest.fixture
def fill():
    """Five cells with all sorts of filling: full, one octant alone, empty octants, near-empty ones."""
    fill = np.random.default_rng(8).uniform(0.0, 1.0, size=(8, 5))
    fill[:, 0] = 1.0
    fill[1:, 1] = 0.0
    fill[2:5, 2] = 0.0
    fill[0, 3] = 0.021
    return fill


def parameters_of(element, cells):
    return 0.03 * np.random.default_rng(9).normal(size=(element.internal, cells))


def numeric_gradient(function, point, step=1e-6):
    """Central differences of a function of a (k, cells) array, one row at a time in all cells."""
    columns = []
    for row in range(len(point)):
        shift = np.zeros((len(point), 1))
        shift[row] = step
        columns.append((function(point + shift) - function(point - shift)) / (2 * step))
    return np.array(columns)


def test_shape_functions_sum_to_one_and_reproduce_position():
    points = np.random.default_rng(0).random((20, 3))
    shape = shape_functions(points)
    np.testing.assert_allclose(shape.sum(axis=1), 1.0, atol=1e-15)
    np.testing.assert_allclose(shape @ CORNERS, points, atol=1e-15)
    np.testing.assert_allclose(
        np.einsum("naj,ai->nij", shape_gradients(points), CORNERS), np.eye(3)[None].repeat(20, 0), atol=1e-15
    )


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_forces_are_the_gradient_of_the_energy(kind, fill, displacement, poisson_ratio):
    """f_a = dW/du_a, and dW/dα, by central differences."""
    element = kind(EDGE, fill, poisson_ratio)
    parameters = parameters_of(element, 5)
    state = element.evaluate(displacement, parameters)
    numeric = numeric_gradient(lambda u: element.evaluate(u, parameters).energy, displacement)
    assert np.abs(state.forces - numeric).max() < 1e-6 * np.abs(state.forces).max()
    if element.internal:
        numeric = numeric_gradient(lambda alpha: element.evaluate(displacement, alpha).energy, parameters)
        assert np.abs(state.internal_forces - numeric).max() < 1e-6 * np.abs(state.internal_forces).max()


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_tangent_is_the_gradient_of_the_forces(kind, fill, displacement, poisson_ratio):
    """K = ∂f/∂u − ∂f/∂α (∂g/∂α)⁻¹ ∂g/∂u, each by central differences; f and g the two gradients of the energy."""
    element = kind(EDGE, fill, poisson_ratio)
    parameters = parameters_of(element, 5)
    tangent = element.tangent(displacement, parameters)
    outer = numeric_gradient(lambda u: element.evaluate(u, parameters).forces, displacement).transpose(2, 1, 0)
    if element.internal:
        cross = numeric_gradient(lambda u: element.evaluate(u, parameters).internal_forces, displacement)
        own = numeric_gradient(lambda alpha: element.evaluate(displacement, alpha).internal_forces, parameters)
        cross, own = cross.transpose(2, 1, 0), own.transpose(2, 1, 0)
        recovery = np.linalg.solve(own, cross)
        outer = outer - cross.transpose(0, 2, 1) @ recovery
        assert np.abs(tangent.recovery - recovery).max() < 1e-6 * np.abs(recovery).max()
    stiffness = unpack(tangent.stiffness).transpose(2, 0, 1)
    assert np.abs(stiffness - outer).max() < 1e-6 * np.abs(stiffness).max()


def test_only_rigid_motions_cost_no_energy(kind):
    """A full cell has exactly six zero modes: three translations, three rotations; no hourglass mode."""
    element = kind(EDGE, FULL, 0.3)
    values = np.linalg.eigvalsh(unpack(element.tangent(*at_rest(element, 1)).stiffness)[:, :, 0])
    assert np.abs(values[:6]).max() < 1e-14
    assert values[6] > 1e-2 * values[-1]


def test_quarter_turn_costs_no_energy(kind):
    """W(R X) = 0 for a rotation R by 90°, where a small-strain law would store most of its energy."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    element = kind(EDGE, FULL, 0.4)
    result = element.evaluate(affine(turn - np.eye(3)), at_rest(element, 1)[1])
    assert abs(result.energy[0]) < 1e-15
    assert np.abs(result.forces).max() < 1e-14
    assert result.smallest_jacobian == pytest.approx(1.0)


def test_energy_of_homogeneous_stretch(kind):
    """W = V [μ/2 (tr FᵀF − 3) − μ ln J + λ/2 ln² J]; Bonet and Wood (2008), eq. 6.27."""
    gradient = np.array([[1.2, 0.1, 0.0], [0.0, 0.9, 0.05], [0.02, 0.0, 1.1]])
    mu, lam = lame(0.35)
    jacobian = np.linalg.det(gradient)
    expected = 0.5 * mu * ((gradient**2).sum() - 3) - mu * np.log(jacobian) + 0.5 * lam * np.log(jacobian) ** 2
    element = kind(EDGE, FULL, 0.35)
    result = element.evaluate(affine(gradient - np.eye(3)), at_rest(element, 1)[1])
    assert result.energy[0] == pytest.approx(expected * EDGE**3, rel=1e-13)
    # a constant stress does no work on the internal parameters, which is why the patch test holds
    assert np.abs(result.internal_forces).max(initial=0.0) < 1e-15


def test_inverted_material_has_infinite_energy(kind):
    element = kind(EDGE, FULL, 0.3)
    result = element.evaluate(affine(np.diag([-2.0, 0.0, 0.0])), at_rest(element, 1)[1])
    assert np.isinf(result.energy).all()
    assert result.smallest_jacobian == pytest.approx(-1.0)


def test_an_inverted_octant_without_material_costs_next_to_nothing(kind):
    """Corner (1, 1, 1) of a cell with material only around corner (0, 0, 0) is pushed through the cell."""
    fill = np.zeros((8, 1))
    fill[0] = 1.0
    element = kind(EDGE, fill, 0.3)
    pushed = np.zeros((24, 1))
    pushed[21:] = -1.2 * EDGE
    state = element.evaluate(pushed, at_rest(element, 1)[1])
    full = kind(EDGE, FULL, 0.3)
    assert np.isinf(full.evaluate(pushed, at_rest(full, 1)[1]).energy[0])
    assert 0.0 < state.energy[0] < 0.02 * EDGE**3
    assert state.smallest_jacobian > 0.5


def test_bending_of_one_cell_is_exact_only_with_enhanced_strains():
    """Pure bending u = (x z, 0, −x²/2)κ at ν = 0: E I κ²/2 = κ² h⁵/24, the parasitic shear of the plain cell left out.

    Source: Hughes (2000), section 4.7; the trilinear cell stores 1 + (1/2)(1 − ν)... = 1.5 times that at ν = 0.
    """
    corner = EDGE * (CORNERS - 0.5)
    curvature = 1e-3
    # the nodes of a symmetric cell all have the same x², so that their vertical displacement is constant
    bent = np.stack([curvature * corner[:, 0] * corner[:, 2], np.zeros(8), np.zeros(8)], axis=1).reshape(24, 1)
    exact = curvature**2 * EDGE**5 / 24
    energies = []
    for element_kind in ELEMENTS:
        element = element_kind(EDGE, FULL, 0.0)
        stiffness = unpack(element.tangent(*at_rest(element, 1)).stiffness)[:, :, 0]
        energies.append(0.5 * float(bent[:, 0] @ stiffness @ bent[:, 0]))
    assert energies[0] == pytest.approx(1.5 * exact, rel=1e-9)
    assert energies[1] == pytest.approx(exact, rel=1e-6)


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_patch_test(kind, poisson_ratio):
    """An affine field prescribed on the boundary is reproduced inside: u = G X, error below 1e-10.

    Source: Irons' patch test; Hughes (2000), section 4.6.
    """
    body = Body.from_distance(whole_cube, 4)
    gradient = np.array([[0.01, 0.02, -0.01], [0.005, -0.02, 0.03], [0.0, 0.01, 0.015]])
    exact = body.node_positions @ gradient.T
    boundary = np.repeat(on_boundary(body)[:, None], 3, axis=1)
    found = solve_dirichlet(full_stiffness(body, poisson_ratio, kind), boundary, exact)
    assert np.abs(found - exact).max() < 1e-10 * np.abs(exact).max()


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_uniaxial_bar_on_rollers(kind, poisson_ratio):
    """Elongation F L/(E A), lateral strain −ν σ/E, to machine precision."""
    body = Body.from_distance(whole_cube, 4)
    x, y, z = body.node_grid.T
    fixed = np.stack([x == 0, y == 0, z == 0], axis=1)
    force = np.zeros((body.nodes, 3))
    top = z == body.cells
    stress = 0.01
    # trapezoidal weights: consistent nodal forces of a uniform traction
    weight = np.where((x == 0) | (x == body.cells), 0.5, 1.0) * np.where((y == 0) | (y == body.cells), 0.5, 1.0)
    force[top, 2] = stress * weight[top] / body.cells**2
    found = solve_dirichlet(full_stiffness(body, poisson_ratio, kind), fixed, np.zeros((body.nodes, 3)), force)
    expected = body.node_positions * stress * np.array([-poisson_ratio, -poisson_ratio, 1.0])
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.49])
def test_manufactured_solution_converges_with_order_two(kind, poisson_ratio):
    """−div σ(u) = f on [0, 1]³ with u = (sin πx sin πy sin πz)·(1, −2, 1)/100 prescribed; ‖u_h − u‖ = O(h²).

    Source: Roache, Code verification by the method of manufactured solutions (2002); f = −(λ+μ) ∇ div u − μ Δ u.
    """
    mu, lam = lame(poisson_ratio)
    amplitude = np.array([0.01, -0.02, 0.01])

    def exact(points):
        return np.sin(np.pi * points).prod(axis=1)[:, None] * amplitude

    def body_force(points):
        sine, cosine = np.sin(np.pi * points), np.cos(np.pi * points)
        hessian = np.empty((len(points), 3, 3))
        for i in range(3):
            for j in range(3):
                factors = sine.copy()
                if i == j:
                    factors[:, i] *= -1.0
                else:
                    factors[:, i], factors[:, j] = cosine[:, i], cosine[:, j]
                hessian[:, i, j] = np.pi**2 * factors.prod(axis=1)
        laplacian = np.einsum("nii->n", hessian)[:, None] * amplitude
        return -(lam + mu) * (hessian @ amplitude) - mu * laplacian

    gauss = 0.5 + (CORNERS - 0.5) / np.sqrt(3.0)
    shape = shape_functions(gauss)
    errors = []
    sizes = [6, 9, 12]
    for cells in sizes:
        body = Body.from_distance(whole_cube, cells)
        points = ((body.active[:, None] + gauss) / cells).reshape(-1, 3)
        density = body_force(points).reshape(-1, 8, 3) / (8 * cells**3)
        forces = body.scatter(np.einsum("ga,mgi->aim", shape, density).reshape(24, -1))
        boundary = np.repeat(on_boundary(body)[:, None], 3, axis=1)
        stiffness = full_stiffness(body, poisson_ratio, kind)
        found = solve_dirichlet(stiffness, boundary, exact(body.node_positions), forces)
        at_points = np.einsum("ga,mai->mgi", shape, found[body.cell_nodes]).reshape(-1, 3)
        errors.append(np.sqrt(((at_points - exact(points)) ** 2).sum(axis=1).mean()))
    order = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert -order == pytest.approx(2.0, abs=0.2), errors
