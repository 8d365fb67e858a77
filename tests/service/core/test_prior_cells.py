import numpy as np

from service.core.prior_assembly import rest_factor, solve_at_rest
from service.core.prior_balance import NeoHookeanSolver
from service.core.prior_cells import Cells, add_bed, at_corners, at_nodes, cell_forces, gradients, mean_at_nodes
from service.core.prior_forces import missing_forces
from service.core.prior_grid import CORNERS, CellGrid

BODY = np.zeros((64, 64, 64), bool)
BODY[10:22, 12:50, :40] = True
BODY[10:55, 12:50, 30:40] = True

GRID = CellGrid.fit(BODY, 60)
CELLS = Cells.of(GRID, 0.3)
M, N, K = len(GRID.cells), len(GRID.nodes), CELLS.nodes.shape[1]


def some(*shape: int) -> np.ndarray:
    return np.random.default_rng(len(shape)).normal(size=shape).astype(np.float32)


def test_cells_that_only_fill_up_have_no_stiffness_and_no_share() -> None:
    assert K % 8 == 0 and K > M == CELLS.own
    assert not CELLS.stiffness[:, :, M:].any()
    assert (CELLS.share[CELLS.around >= M] == 0.0).all()
    np.testing.assert_allclose(CELLS.share.sum(axis=0), 1.0, atol=1e-6)


def test_nodes_of_a_cell_have_numbers_that_lie_near() -> None:
    """Not farther apart than a plane across the longest axis, a row and one have nodes."""
    low, middle, _ = np.sort(np.array(GRID.shape) + 1)
    assert (np.ptp(GRID.cell_nodes, axis=1) <= low * middle + low + 1).all()
    assert len(np.unique(GRID.nodes, axis=0)) == N
    expected = GRID.cells[:, None] + CORNERS
    np.testing.assert_array_equal(GRID.nodes[GRID.cell_nodes], expected)


def test_corners_have_the_values_of_their_nodes_and_a_linear_field_its_slope() -> None:
    slope = some(3, 3)
    u = (slope @ GRID.node_positions.T).astype(np.float32)
    corners, gradient = np.empty((8, 3, K), np.float32), np.empty((3, 3, K), np.float32)
    at_corners(CELLS, u, corners)
    np.testing.assert_array_equal(corners[:, :, :M], u[:, GRID.cell_nodes].transpose(2, 0, 1))
    gradients(CELLS, corners, gradient)
    np.testing.assert_allclose(gradient[:, :, :M], np.repeat(slope[:, :, None], M, axis=2), atol=1e-4)


def test_cell_forces_are_stiffness_times_displacement() -> None:
    u, forces = some(8, 3, K), np.empty((8, 3, K), np.float32)
    cell_forces(CELLS, u, forces)
    expected = np.einsum("abk,bk->ak", CELLS.stiffness, u.reshape(24, K)).reshape(8, 3, K)
    np.testing.assert_allclose(forces, expected, atol=1e-5)


def test_sums_and_means_at_nodes_are_over_the_cells_around() -> None:
    corners, result = some(8, 3, K), np.empty((3, N), np.float32)
    corners[:, :, M:] = 0.0
    at_nodes(CELLS, corners, result)
    expected = np.zeros((3, N))
    np.add.at(expected, (slice(None), GRID.cell_nodes), corners[:, :, :M].transpose(1, 2, 0))
    np.testing.assert_allclose(result, expected, atol=1e-5)
    matrices, means = some(3, 3, K), np.empty((3, 3, N), np.float32)
    mean_at_nodes(CELLS, matrices, means)
    fill = np.maximum(GRID.fill, 1e-3)
    table = np.zeros((N, M))
    table[GRID.cell_nodes.T, np.arange(M)] = fill
    table /= table.sum(axis=1, keepdims=True)
    np.testing.assert_allclose(means, matrices[:, :, :M] @ table.T, atol=1e-5)


def test_the_bed_pushes_back_on_the_sole_alone() -> None:
    u, force = some(3, N), np.zeros((3, N), np.float32)
    add_bed(CELLS, u, force)
    assert not force[:, GRID.nodes[:, 2] > 0].any()
    u[...] = 1.0
    force[...] = 0.0
    add_bed(CELLS, u, force)
    sole = BODY[:, :, 0].sum() / 64**2
    np.testing.assert_allclose(force.sum(axis=1), 300.0 * sole, rtol=1e-3)


def test_a_correction_is_what_its_formulas_say() -> None:
    """What is missing, by the factor at rest between the frames of the nodes; these by singular values."""
    solver = NeoHookeanSolver(GRID, 0.3)
    u, force = 0.02 * some(1, 3, N), 1e-3 * some(1, 3, N)[:, ::-1].copy()
    corners = u[0][:, GRID.cell_nodes] + ((CORNERS - 0.5) * GRID.edges).T[:, None]  # (3, m, 8)
    signs = np.where(CORNERS == 1, 0.25, -0.25) / GRID.edges
    first, _, last = np.linalg.svd(np.einsum("imb,bj->mij", corners, signs))
    rotation = first @ last
    means = np.zeros((3, 3, N))
    np.add.at(
        means, (slice(None), slice(None), GRID.cell_nodes),
        (rotation * GRID.fill[:, None, None]).transpose(1, 2, 0)[..., None],
    )  # fmt: skip
    first, _, last = np.linalg.svd(means.transpose(2, 0, 1))
    frames = first @ last
    missing = np.empty((3, N), np.float32)
    missing_forces(solver.cells, u[0], force[0], missing)
    left = np.einsum("nji,jn->in", frames, missing).astype(np.float32)[None]
    solve_at_rest(rest_factor(CELLS), left, left)
    expected = np.einsum("nij,jn->in", frames, left[0])
    np.testing.assert_allclose(solver.correction(u, force)[0], expected, atol=2e-3 * np.abs(expected).max())
