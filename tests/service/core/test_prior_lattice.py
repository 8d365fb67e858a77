import numpy as np

from service.core.prior import ElasticPrior
from service.core.prior_grid import CellGrid
from service.core.prior_lattice import forward_lattice


def table() -> np.ndarray:
    """A plate on one leg: most of the box below the plate has no cell."""
    body = np.zeros((64, 64, 64), bool)
    body[10:54, 12:52, 30:42] = True
    body[10:20, 12:52, :30] = True
    return body


def test_a_linear_field_comes_out_exactly_in_the_cells_and_constant_beyond_the_box() -> None:
    grid = CellGrid.fit(table(), 125)
    slopes = np.array([[0.1, 0.0, -0.2], [0.0, 0.3, 0.0], [0.05, 0.0, 0.1]])
    nodal = np.stack([slopes @ grid.node_positions.T, 2 * slopes @ grid.node_positions.T]).astype(np.float32)
    lattice = forward_lattice(grid, nodal)
    steps = (np.arange(16) + 0.5) / 16
    centres = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"))
    expected = np.einsum("ca,axyz->cxyz", slopes, centres)
    plate = (slice(None), slice(3, 13), slice(4, 12), 9)  # well inside the plate
    np.testing.assert_allclose(lattice[0][plate], expected[plate], atol=1e-5)
    np.testing.assert_allclose(lattice[1], 2 * lattice[0], atol=1e-5)
    np.testing.assert_array_equal(lattice[0][..., 12], lattice[0][..., 15])  # above the plate


def test_places_without_a_node_take_their_neighbours_values() -> None:
    grid = CellGrid.fit(table(), 125)
    lattice = forward_lattice(grid, np.ones((1, 3, len(grid.nodes)), np.float32))
    np.testing.assert_allclose(lattice, 1.0, atol=1e-6)


def test_the_solve_gives_its_forward_field_on_the_lattice() -> None:
    condition = np.array([0.7, 0.5, 42 / 64, 0.0, 0.0, -1.0, -3.0, 0.3, 0.1], np.float32)
    answer = ElasticPrior(table(), 0.3).displacements([condition])
    assert answer.forward.shape == (1, 3, 16, 16, 16)
    assert answer.forward[0, 2].min() < 0.5 * answer.nodal[0, 2].min() < 0.0
