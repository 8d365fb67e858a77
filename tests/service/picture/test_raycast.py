"""Ray casting against bodies whose silhouette and surface are known in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from service.core.arrays import GRID_SIZE, Occupancy
from service.picture.raycast import SUPERSAMPLING, View, cast, normals, sample, smooth_field, view_from_camera

RADIUS = 14.0
CENTRE = np.array([32.0, 30.0, 34.0])


def _centres() -> np.ndarray:
    return np.stack(np.meshgrid(*[np.arange(GRID_SIZE) + 0.5] * 3, indexing="ij"), -1)


def _ball() -> Occupancy:
    return np.asarray(np.linalg.norm(_centres() - CENTRE, axis=-1) < RADIUS)


def _camera_from_grid(eye: np.ndarray) -> np.ndarray:
    """A camera at `eye` that looks at the grid's middle, x right and y down."""
    forward = np.full(3, 32.0) - eye
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    camera_from_grid = np.eye(4)
    camera_from_grid[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    camera_from_grid[:3, 3] = -camera_from_grid[:3, :3] @ eye
    return camera_from_grid


@pytest.fixture(scope="module")
def view() -> View:
    return view_from_camera(_camera_from_grid(np.array([32.0, -200.0, 120.0])), _ball(), 120, 160)


def test_sampling_a_linear_field_is_exact() -> None:
    field = (_centres() @ np.array([0.3, -0.2, 0.1])).astype(np.float32)
    places = np.random.default_rng(0).uniform(1, 62, (100, 3)).astype(np.float32)
    np.testing.assert_allclose(sample(field, places), places @ np.array([0.3, -0.2, 0.1]), atol=1e-4)


def test_the_silhouette_of_a_ball_has_its_area(view: View) -> None:
    hit, _ = cast(smooth_field(_ball()), view)
    pixel_area = (2 * view.half_width / view.cols / SUPERSAMPLING) * (2 * view.half_height / view.rows / SUPERSAMPLING)
    assert hit.sum() * pixel_area == pytest.approx(np.pi * RADIUS**2, rel=0.02)


def test_rays_stop_on_the_near_side_of_a_ball_and_normals_point_out(view: View) -> None:
    field = smooth_field(_ball())
    _, places = cast(field, view)
    distance = np.linalg.norm(places - CENTRE, axis=1)
    assert np.abs(distance - RADIUS).mean() < 0.1
    # A ray that grazes the rim 0.3 voxel inside it meets the stairs of a voxel ball up to 3 voxels late.
    assert ((places - CENTRE) @ view.toward > -3.0).all()
    radial = (places - CENTRE) / distance[:, None]
    assert np.median((normals(field, places) * radial).sum(1)) > 0.99


def test_a_wall_one_voxel_thin_is_still_there() -> None:
    wall = np.zeros((GRID_SIZE,) * 3, bool)
    wall[20:44, 31, 0:30] = True
    view = view_from_camera(_camera_from_grid(np.array([32.0, -200.0, 120.0])), wall, 100, 100)
    field = smooth_field(wall)
    assert ((field > 0.5) == wall).all()
    hit, _ = cast(field, view)
    pixel_area = (2 * view.half_width / view.cols / SUPERSAMPLING) ** 2
    facing = 24 * 30 * abs(view.toward[1])
    assert hit.sum() * pixel_area == pytest.approx(facing, rel=0.12)


def test_an_empty_grid_meets_no_ray(view: View) -> None:
    hit, places = cast(np.zeros((GRID_SIZE,) * 3, np.float32), view)
    assert not hit.any()
    assert places.shape == (0, 3)


def test_the_view_is_from_the_cameras_side_and_a_little_above() -> None:
    eye = np.array([-100.0, -80.0, 90.0])
    view = view_from_camera(_camera_from_grid(eye), _ball(), 100, 100)
    assert view.toward[:2] @ eye[:2] > 0.95 * np.linalg.norm(view.toward[:2]) * np.linalg.norm(eye[:2])
    eye_elevation = np.arcsin(eye[2] / np.linalg.norm(eye))
    assert np.arcsin(view.toward[2]) == pytest.approx(eye_elevation + np.radians(5), abs=1e-6)
    axes = np.stack([view.right, view.up, view.toward])
    np.testing.assert_allclose(axes @ axes.T, np.eye(3), atol=1e-12)


def test_a_camera_straight_above_has_a_view_too() -> None:
    camera_from_grid = np.diag([1.0, -1.0, -1.0, 1.0])
    camera_from_grid[:3, 3] = (0.0, 0.0, 1.0)
    view = view_from_camera(camera_from_grid, _ball(), 50, 50)
    assert np.degrees(np.arcsin(view.toward[2])) == pytest.approx(45.0)


def test_the_whole_body_is_in_the_view(view: View) -> None:
    pixels = view.project(np.argwhere(_ball()) + 0.5)
    assert (pixels > 0).all()
    assert (pixels < [view.cols, view.rows]).all()
