import numpy as np

from training.simulation.element_order import gather, scatter

CELLS = np.array([[0, 1, 2, 3, 4, 5, 6, 7], [4, 5, 6, 7, 8, 9, 10, 11]])


def test_every_corner_of_every_cell_gets_its_node():
    nodal = np.random.default_rng(0).normal(size=(12, 3))
    element = np.empty((24, 2))
    gather(nodal, CELLS, element)
    np.testing.assert_array_equal(element, nodal[CELLS].reshape(2, 24).T)


def test_what_comes_back_is_summed_at_shared_nodes():
    """⟨gather(u), f⟩ = ⟨u, scatter(f)⟩ for any u and f."""
    rng = np.random.default_rng(1)
    nodal, force = rng.normal(size=(12, 3)), rng.normal(size=(24, 2))
    element, summed = np.empty((24, 2)), np.zeros((12, 3))
    gather(nodal, CELLS, element)
    scatter(force, CELLS, summed)
    np.testing.assert_allclose((element * force).sum(), (nodal * summed).sum(), rtol=1e-13)
    np.testing.assert_allclose(summed[5], force[15:18, 0] + force[3:6, 1], rtol=1e-15)
