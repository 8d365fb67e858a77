import numpy as np
import pytest

from tests.training.simulation.bodies import box, sphere
from training.simulation.surface import project_to_surface, surface_quadrature


def test_projection_reaches_a_box_face():
    points = np.array([[0.5, 0.5, 0.63], [0.71, 0.4, 0.2]])
    projected, normal = project_to_surface(box([0.5, 0.5, 0.3], [0.2, 0.2, 0.3]), points)
    np.testing.assert_allclose(projected, [[0.5, 0.5, 0.6], [0.7, 0.4, 0.2]], atol=1e-5)
    np.testing.assert_allclose(normal, [[0, 0, 1], [1, 0, 0]], atol=1e-3)


def test_areas_sum_to_that_of_a_sphere():
    """4π r², and a mean normal of zero."""
    spacing = 1 / 96
    axis = np.arange(0.5 * spacing, 1.0, spacing)
    lattice = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    points, normals, area = surface_quadrature(sphere([0.5, 0.48, 0.51], 0.3), lattice, spacing)
    assert area.sum() == pytest.approx(4 * np.pi * 0.3**2, rel=2e-3)
    np.testing.assert_allclose(area @ normals, 0.0, atol=1e-3 * area.sum())
    np.testing.assert_allclose(np.linalg.norm(points - [0.5, 0.48, 0.51], axis=1), 0.3, atol=1e-4)
