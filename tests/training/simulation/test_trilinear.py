import numpy as np

from training.simulation.elements import CORNERS
from training.simulation.trilinear import coefficients, corner_sums

PLACE = CORNERS - 0.5
MONOMIALS = np.stack(
    [
        np.ones(8), PLACE[:, 0], PLACE[:, 1], PLACE[:, 2], PLACE[:, 0] * PLACE[:, 1], PLACE[:, 1] * PLACE[:, 2],
        PLACE[:, 2] * PLACE[:, 0], PLACE.prod(axis=1),
    ],
    axis=1,
)  # fmt: skip


def test_the_polynomial_takes_the_values_at_the_corners():
    values = np.random.default_rng(0).normal(size=8)
    np.testing.assert_allclose(MONOMIALS @ coefficients(*values), values, atol=1e-15)


def test_corner_sums_are_the_transpose():
    """y · T x = Tᵀ y · x"""
    rng = np.random.default_rng(1)
    values, functional = rng.normal(size=8), rng.normal(size=8)
    assert abs(functional @ np.array(coefficients(*values)) - np.array(corner_sums(*functional)) @ values) < 1e-14
