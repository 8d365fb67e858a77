"""Surfaces of bodies whose surface is known: where they lie, that they are closed, and which way they face."""

import numpy as np
import pytest

from service.core.surface_mesh import surface_mesh, vertex_normals
from tests.poses import pose

CENTRES = np.indices((64, 64, 64)) + 0.5
CENTRE, RADIUS = np.array([32.2, 31.0, 30.5]), 20.3
FROM_SURFACE = RADIUS - np.sqrt(((CENTRES - CENTRE[:, None, None, None]) ** 2).sum(0))
BALL = np.clip(0.5 + FROM_SURFACE / 4, 0.0, 1.0).astype(np.float32)
IDENTITY = np.eye(4)


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Enclosed, positive where triangles face outwards (divergence theorem)."""
    a, b, c = (vertices[faces[:, corner]].astype(np.float64) for corner in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def is_closed(faces: np.ndarray) -> bool:
    """Every edge is run along as often in one direction as in the other."""
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    there, back = (np.unique(some, axis=0, return_counts=True) for some in (edges, edges[:, ::-1]))
    return bool(np.array_equal(there[0], back[0]) and np.array_equal(there[1], back[1]))


def test_the_surface_of_a_ball_lies_where_the_ball_ends():
    vertices, faces = surface_mesh(BALL, IDENTITY, 1.0, 0.5)
    assert (vertices.dtype, faces.dtype) == (np.float32, np.int32)
    np.testing.assert_allclose(np.linalg.norm(vertices - CENTRE, axis=1), RADIUS, atol=0.03)
    assert volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.005)
    assert is_closed(faces)
    # Euler's formula for a sphere: V - E + F = 2, with 3 F / 2 edges.
    assert len(vertices) - len(faces) // 2 == 2
    assert set(np.unique(faces)) == set(range(len(vertices)))


def test_the_threshold_moves_it_by_what_the_field_says():
    for threshold in (0.3, 0.7):
        vertices, _ = surface_mesh(BALL, IDENTITY, 1.0, threshold)
        # The field falls by a quarter a voxel.
        expected = RADIUS + 4 * (0.5 - threshold)
        assert np.linalg.norm(vertices - CENTRE, axis=1).mean() == pytest.approx(expected, abs=0.03)


def test_normals_point_outwards():
    vertices, faces = surface_mesh(BALL, IDENTITY, 1.0, 0.5)
    outwards = (vertices - CENTRE) / np.linalg.norm(vertices - CENTRE, axis=1, keepdims=True)
    cosines = (vertex_normals(vertices, faces) * outwards).sum(axis=1)
    assert np.degrees(np.arccos(cosines.clip(-1, 1))).max() < 4.0


def test_a_binary_ball_has_no_stairs_and_hardly_shrinks():
    vertices, faces = surface_mesh(FROM_SURFACE > 0, IDENTITY, 1.0)
    assert np.abs(np.linalg.norm(vertices - CENTRE, axis=1) - RADIUS).mean() < 0.1
    assert volume(vertices, faces) == pytest.approx(4 / 3 * np.pi * RADIUS**3, rel=0.02)
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    normals = np.cross(b - a, c - a)
    outwards = (a + b + c) / 3 - CENTRE
    cosines = (normals * outwards).sum(1) / np.linalg.norm(normals, axis=1) / np.linalg.norm(outwards, axis=1)
    assert np.degrees(np.arccos(cosines.clip(-1, 1))).mean() < 3.0


def test_it_is_metres_in_the_camera_frame():
    camera_from_grid = pose((0.4, -0.2, 0.9), (0.05, 0.02, 0.7))
    vertices, faces = surface_mesh(BALL, camera_from_grid, 0.004, 0.5)
    centre_m = camera_from_grid[:3, :3] @ (CENTRE * 0.004) + camera_from_grid[:3, 3]
    np.testing.assert_allclose(np.linalg.norm(vertices - centre_m, axis=1), 0.004 * RADIUS, atol=0.0002)
    assert volume(vertices - centre_m.astype(np.float32), faces) > 0.0


def test_a_wall_one_voxel_thick_stays():
    wall = np.zeros((64, 64, 64), bool)
    wall[30, 10:50, 10:50] = True
    vertices, faces = surface_mesh(wall, IDENTITY, 1.0)
    assert is_closed(faces)
    middle = vertices[(np.abs(vertices[:, 1:] - 30) < 10).all(axis=1)]
    np.testing.assert_allclose(np.unique(middle[:, 0].round(3)), [30.0, 31.0])


def test_a_body_at_the_sides_of_the_grid_is_closed_there():
    vertices, faces = surface_mesh(np.ones((64, 64, 64), bool), IDENTITY, 1.0)
    assert is_closed(faces)
    assert 0.0 <= vertices.min() < 0.5 and 63.5 < vertices.max() <= 64.0
    assert volume(vertices, faces) == pytest.approx(64**3, rel=0.01)


def test_a_single_voxel_has_a_surface():
    voxel = np.zeros((64, 64, 64), bool)
    voxel[5, 6, 7] = True
    vertices, faces = surface_mesh(voxel, IDENTITY, 1.0)
    assert (len(vertices), len(faces)) == (8, 12)
    np.testing.assert_allclose(vertices.mean(axis=0), [5.5, 6.5, 7.5])
    assert volume(vertices, faces) > 0.0


@pytest.mark.parametrize("field", [np.zeros((64, 64, 64), bool), np.zeros((64, 64, 64), np.float32)])
def test_nothing_has_none(field):
    vertices, faces = surface_mesh(field, IDENTITY, 1.0, 0.5)
    assert (vertices.shape, faces.shape) == ((0, 3), (0, 3))
    assert vertex_normals(vertices, faces).shape == (0, 3)


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("seed", range(2))
def test_whatever_the_voxels_it_is_closed_and_each_vertex_is_in_its_cell(seed, binary):
    random = np.random.default_rng(seed)
    field = np.zeros((64, 64, 64), np.float32)
    field[20:32, 40:52, :10] = random.random((12, 12, 10))
    vertices, faces = surface_mesh(field > 0.5 if binary else field, IDENTITY, 1.0, 0.5)
    assert is_closed(faces)
    assert np.isfinite(vertices).all()
    # No two vertices share a cell between voxel centres, so none leaves its own.
    assert (vertices.min(axis=0) >= [19.5, 39.5, -0.5]).all() and (vertices.max(axis=0) <= [32.5, 52.5, 10.5]).all()
    np.testing.assert_allclose(np.linalg.norm(vertex_normals(vertices, faces), axis=1), 1.0, atol=1e-4)
