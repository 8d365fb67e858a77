import numpy as np
import pytest

from training.simulation.material_law import cofactor, lame


def test_lame_parameters_of_known_material():
    """ν = 1/4 makes λ = μ = 0.4 E (a Poisson solid)."""
    assert lame(0.25) == pytest.approx((0.4, 0.4))


@pytest.mark.parametrize("poisson_ratio", [-0.1, 0.495, 0.5, float("nan")])
def test_unverified_poisson_ratio_is_refused(poisson_ratio):
    with pytest.raises(ValueError, match=r"0\.49"):
        lame(poisson_ratio)


def test_cofactor_is_determinant_times_inverse_transposed():
    gradient = np.eye(3) + 0.3 * np.random.default_rng(1).normal(size=(4, 2, 3, 3))
    result, determinant = cofactor(gradient.reshape(4, 2, 9).transpose(0, 2, 1).copy())
    expected = np.linalg.det(gradient)
    np.testing.assert_allclose(determinant, expected, rtol=1e-12)
    inverse = np.linalg.inv(gradient).transpose(0, 1, 3, 2) * expected[..., None, None]
    np.testing.assert_allclose(result.transpose(0, 2, 1).reshape(4, 2, 3, 3), inverse, atol=1e-12)
