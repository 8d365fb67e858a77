import numpy as np
import pytest

from tests.training.simulation.bodies import sphere
from training.simulation.patch import surface_patch


def test_a_patch_of_a_ball_has_the_area_of_its_cap():
    """A cap of chord R has the area π R²; its points lie on the ball and its normals point away from the middle."""
    points, normals, area = surface_patch(sphere([0.5, 0.48, 0.31], 0.3), np.array([0.5, 0.48, 0.61]), 0.1, 0.005)
    np.testing.assert_allclose(np.linalg.norm(points - [0.5, 0.48, 0.31], axis=1), 0.3, atol=1e-4)
    np.testing.assert_allclose(normals, (points - [0.5, 0.48, 0.31]) / 0.3, atol=2e-3)
    assert area.sum() == pytest.approx(np.pi * 0.1**2, rel=0.05)
