import numpy as np
import pytest
import scipy.sparse as sp

from training.simulation.factor import NotPositiveDefinite, factorise


@pytest.fixture(params=["pardiso", "superlu"])
def backend(request):
    if request.param == "pardiso":
        pytest.importorskip("pypardiso")
    return request.param


def laplacian(size=200):
    return sp.csr_array(sp.diags_array([2.0, -1.0], offsets=[0, 1], shape=(size, size)))


def full(upper):
    return (upper + sp.triu(upper, 1).T).toarray()


def test_solves_every_right_hand_side(backend):
    upper = laplacian()
    rhs = np.random.default_rng(0).normal(size=(200, 7))
    np.testing.assert_allclose(full(upper) @ factorise(upper, backend).solve(rhs), rhs, atol=1e-9)


def test_refactoring_uses_the_new_values_and_leaves_the_callers_matrix(backend):
    upper = laplacian()
    before = upper.data.copy()
    factor = factorise(upper, backend)
    factor.refactor(4.0 * upper.data)
    rhs = np.ones((200, 1))
    np.testing.assert_allclose(4.0 * full(upper) @ factor.solve(rhs), rhs, atol=1e-9)
    np.testing.assert_array_equal(upper.data, before)


def test_a_twin_is_an_approximate_inverse_of_its_own_values(backend):
    """Single precision where the library has it; the first factor stays what it was."""
    upper = laplacian()
    factor = factorise(upper, backend)
    twin = factor.twin()
    twin.refactor(4.0 * upper.data)
    rhs = np.random.default_rng(0).normal(size=(200, 2))
    exact = np.linalg.solve(full(upper), rhs)
    np.testing.assert_allclose(4.0 * twin.solve(rhs), exact, atol=1e-3 * np.abs(exact).max())
    np.testing.assert_allclose(factor.solve(rhs), exact, atol=1e-9 * np.abs(exact).max())
    assert twin.solve(rhs).dtype == np.float64
    with pytest.raises(NotPositiveDefinite):
        twin.refactor(-upper.data)


def test_two_factors_live_side_by_side(backend):
    first, second = factorise(laplacian(), backend), factorise(10.0 * laplacian(), backend)
    rhs = np.ones((200, 1))
    np.testing.assert_allclose(first.solve(rhs), 10.0 * second.solve(rhs), rtol=1e-9)


def test_indefinite_matrix_is_named(backend):
    upper = laplacian()
    upper = upper - 1.5 * sp.eye_array(200, format="csr")
    with pytest.raises(NotPositiveDefinite):
        factorise(sp.csr_array(upper), backend)
