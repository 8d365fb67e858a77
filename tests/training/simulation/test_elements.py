import numpy as np
import pytest

from tests.training.simulation.bodies import full_stiffness, on_boundary, solve_dirichlet, whole_cube
from training.simulation.body import Body
from training.simulation.elements import CORNERS, PAIRS_24, MeanDilatationHexahedron, shape_functions, shape_gradients
from training.simulation.material_law import lame

EDGE = 0.5


def unpack(upper):
    full = np.zeros((24, 24, upper.shape[1]))
    full[PAIRS_24] = upper
    full[PAIRS_24[1], PAIRS_24[0]] = upper
    return full


def affine(gradient):
    """Element displacements of u = G X on one cell."""
    return (EDGE * CORNERS @ gradient.T).reshape(24, 1)


@pytest.fixture
def element():
    return MeanDilatationHexahedron(EDGE)


@pytest.fixture
def state():
    rng = np.random.default_rng(7)
    return 0.04 * rng.normal(size=(24, 5)), rng.uniform(0.01, 1.0, size=(8, 5)) * EDGE**3 / 8


def test_shape_functions_sum_to_one_and_reproduce_position():
    points = np.random.default_rng(0).random((20, 3))
    shape = shape_functions(points)
    np.testing.assert_allclose(shape.sum(axis=1), 1.0, atol=1e-15)
    np.testing.assert_allclose(shape @ CORNERS, points, atol=1e-15)
    np.testing.assert_allclose(np.einsum("naj,ai->nij", shape_gradients(points), CORNERS), np.eye(3)[None].repeat(20, 0), atol=1e-15)


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_forces_are_the_gradient_of_the_energy(element, state, poisson_ratio):
    """f_a = dW/du_a by central differences."""
    displacement, weights = state
    forces = element.evaluate(displacement, weights, poisson_ratio).forces
    numeric = np.empty_like(forces)
    step = 1e-6
    for a in range(24):
        shift = np.zeros((24, 1))
        shift[a] = step
        ahead = element.evaluate(displacement + shift, weights, poisson_ratio).energy
        behind = element.evaluate(displacement - shift, weights, poisson_ratio).energy
        numeric[a] = (ahead - behind) / (2 * step)
    assert np.abs(forces - numeric).max() < 1e-6 * np.abs(forces).max()


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_tangent_is_the_gradient_of_the_forces(element, state, poisson_ratio):
    """K_ab = df_a/du_b by central differences."""
    displacement, weights = state
    tangent = unpack(element.tangent(displacement, weights, poisson_ratio))
    numeric = np.empty_like(tangent)
    step = 1e-6
    for a in range(24):
        shift = np.zeros((24, 1))
        shift[a] = step
        ahead = element.evaluate(displacement + shift, weights, poisson_ratio).forces
        behind = element.evaluate(displacement - shift, weights, poisson_ratio).forces
        numeric[a] = (ahead - behind) / (2 * step)
    assert np.abs(tangent - numeric).max() < 1e-6 * np.abs(tangent).max()


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_linear_stiffness_is_the_tangent_at_rest(element, state, poisson_ratio):
    weights = state[1]
    rest = np.zeros((24, weights.shape[1]))
    tangent = element.tangent(rest, weights, poisson_ratio)
    np.testing.assert_allclose(element.stiffness(weights, poisson_ratio), tangent, rtol=1e-12, atol=1e-13)


def test_only_rigid_motions_cost_no_energy(element):
    """A full cell has exactly six zero modes: three translations, three rotations; no hourglass mode."""
    stiffness = unpack(element.stiffness(np.full((8, 1), EDGE**3 / 8), 0.3))[:, :, 0]
    values = np.linalg.eigvalsh(stiffness)
    assert np.abs(values[:6]).max() < 1e-14
    assert values[6] > 1e-2 * values[-1]


def test_quarter_turn_costs_no_energy(element):
    """W(R X) = 0 for a rotation R by 90°, where a small-strain law would store most of its energy."""
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    result = element.evaluate(affine(turn - np.eye(3)), np.full((8, 1), EDGE**3 / 8), 0.4)
    assert abs(result.energy[0]) < 1e-15
    assert np.abs(result.forces).max() < 1e-14
    assert result.smallest_jacobian == pytest.approx(1.0)


def test_energy_of_homogeneous_stretch(element):
    """W = V [μ/2 (tr FᵀF − 3) − μ ln J + λ/2 ln² J]; Bonet and Wood (2008), eq. 6.27."""
    gradient = np.array([[1.2, 0.1, 0.0], [0.0, 0.9, 0.05], [0.02, 0.0, 1.1]])
    mu, lam = lame(0.35)
    jacobian = np.linalg.det(gradient)
    expected = 0.5 * mu * ((gradient**2).sum() - 3) - mu * np.log(jacobian) + 0.5 * lam * np.log(jacobian) ** 2
    result = element.evaluate(affine(gradient - np.eye(3)), np.full((8, 1), EDGE**3 / 8), 0.35)
    assert result.energy[0] == pytest.approx(expected * EDGE**3, rel=1e-13)


def test_inverted_cell_has_infinite_energy(element):
    mirrored = affine(np.diag([-2.0, 0.0, 0.0]))
    result = element.evaluate(mirrored, np.full((8, 1), EDGE**3 / 8), 0.3)
    assert np.isinf(result.energy).all()
    assert result.smallest_jacobian == pytest.approx(-1.0)


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_patch_test(poisson_ratio):
    """An affine field prescribed on the boundary is reproduced inside: u = G X, error below 1e-10.

    Source: Irons' patch test; Hughes (2000), section 4.6.
    """
    body = Body.from_distance(whole_cube, 4)
    gradient = np.array([[0.01, 0.02, -0.01], [0.005, -0.02, 0.03], [0.0, 0.01, 0.015]])
    exact = body.node_positions @ gradient.T
    boundary = np.repeat(on_boundary(body)[:, None], 3, axis=1)
    found = solve_dirichlet(full_stiffness(body, poisson_ratio), boundary, exact)
    assert np.abs(found - exact).max() < 1e-10 * np.abs(exact).max()


@pytest.mark.parametrize("poisson_ratio", [0.0, 0.3, 0.49])
def test_uniaxial_bar_on_rollers(poisson_ratio):
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
    found = solve_dirichlet(full_stiffness(body, poisson_ratio), fixed, np.zeros((body.nodes, 3)), force)
    expected = body.node_positions * stress * np.array([-poisson_ratio, -poisson_ratio, 1.0])
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.parametrize("poisson_ratio", [0.3, 0.49])
def test_manufactured_solution_converges_with_order_two(poisson_ratio):
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
        found = solve_dirichlet(full_stiffness(body, poisson_ratio), boundary, exact(body.node_positions), forces)
        at_points = np.einsum("ga,mai->mgi", shape, found[body.cell_nodes]).reshape(-1, 3)
        errors.append(np.sqrt(((at_points - exact(points)) ** 2).sum(axis=1).mean()))
    order = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert -order == pytest.approx(2.0, abs=0.2), errors
