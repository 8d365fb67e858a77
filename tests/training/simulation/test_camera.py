"""Rendered depth against analytic spheres, boxes and planes; where cameras and clutter are put."""

from __future__ import annotations

import math

import numpy as np
import pytest

from service.core.camera import Intrinsics
from service.core.grids import invert_rigid
from training.simulation.camera import look_at, place_clutter, project, render, sample_viewpoint
from training.simulation.families import sample_shape
from training.simulation.shapes import Field, Shape, stand, tight_bounds
from training.simulation.shapes.primitives import Box, Sphere, Torus

CAMERA = Intrinsics(fx=600.0, fy=610.0, cx=318.0, cy=242.0, width=640, height=480)
EYE = (0.7, -0.5, 0.6)


def rays(camera_from_world: np.ndarray, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Eye and directions in the world, advancing 1 m along the optical axis."""
    v, u = np.indices((intrinsics.height, intrinsics.width))
    local = np.stack(
        [(u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy, np.ones(u.shape)], axis=-1
    )
    world_from_camera = invert_rigid(camera_from_world)
    return world_from_camera[:3, 3], local @ world_from_camera[:3, :3].T


def test_plane_depth_is_analytic_and_nothing_is_above_the_horizon() -> None:
    pose = look_at(EYE, (0, 0, 0.3))
    depth, mask = render(Shape("ball", Sphere(0.1).shift(z=-9)), pose, CAMERA, farthest_m=20)
    eye, directions = rays(pose, CAMERA)
    expected = -eye[2] / directions[..., 2]
    seen = (expected > 0) & (expected < 19)
    assert np.abs(depth[seen] - expected[seen]).max() < 1e-4
    assert np.isnan(depth[directions[..., 2] >= 0]).all()
    assert not mask.any()


def test_a_table_ends_where_it_is_told_to() -> None:
    pose = look_at(EYE, (0, 0, 0))
    nowhere = Shape("ball", Sphere(0.1).shift(z=-9))
    endless, _ = render(nowhere, pose, CAMERA)
    table, _ = render(nowhere, pose, CAMERA, table_m=(-0.3, 0.2, -0.1, 0.15))
    eye, directions = rays(pose, CAMERA)
    x, y = (eye[axis] + endless * directions[..., axis] for axis in range(2))
    on = (x >= -0.3) & (x <= 0.2) & (y >= -0.1) & (y <= 0.15)
    assert 1000 < on.sum() < on.size / 2
    assert (np.isfinite(table) == on).mean() > 0.9999  # but for rounding along the rim
    both = np.isfinite(table) & on
    np.testing.assert_array_equal(table[both], endless[both])


def test_a_sphere_has_its_analytic_depth() -> None:
    """Roots of |eye + t·direction − centre|² = r²."""
    centre, radius = np.array([0.02, 0.03, 0.12]), 0.12
    pose = look_at(EYE, (0, 0, 0.1), roll_rad=0.2)
    depth, mask = render(Shape("ball", Sphere(radius).shift(*centre.tolist())), pose, CAMERA, plane=False)
    eye, directions = rays(pose, CAMERA)
    a = (directions**2).sum(axis=-1)
    b = directions @ (eye - centre)
    discriminant = b**2 - a * (((eye - centre) ** 2).sum() - radius**2)
    hit = discriminant > 0
    expected = (-b - np.sqrt(np.where(hit, discriminant, np.nan))) / a
    # The outline may differ where a ray grazes the ball by less than a thousandth of a pixel.
    assert (mask != hit).sum() <= 3
    both = mask & hit
    assert both.sum() > 15_000
    assert np.abs(depth[both] - expected[both]).max() < 1e-4
    assert np.isnan(depth[~mask]).all()


def test_a_box_on_its_table_has_its_analytic_depth() -> None:
    """Entry into the box by the slab method, the plane elsewhere."""
    pose = look_at(EYE, (0, 0, 0.1))
    depth, mask = render(Shape("box", Box((0.15, 0.08, 0.1)).shift(z=0.1)), pose, CAMERA)
    eye, directions = rays(pose, CAMERA)
    low, high = np.array([-0.15, -0.08, 0.0]), np.array([0.15, 0.08, 0.2])
    first, second = (low - eye) / directions, (high - eye) / directions
    near, far = np.minimum(first, second).max(axis=-1), np.maximum(first, second).min(axis=-1)
    expected = np.where(near < far, near, -eye[2] / directions[..., 2])
    inside = (near < far - 1e-3) | (near > far + 1e-3)  # off the outline, where rounding decides
    seen = inside & (expected < 5)
    assert np.abs(depth[seen] - expected[seen]).max() < 1e-4
    assert (mask == (near < far))[inside].all()


def test_thin_things_are_not_stepped_over() -> None:
    """A wire two pixels thick is seen all along, in front of a wall behind it."""
    wire: Field = Torus(0.1, 0.0012).turn("x", math.pi / 2).shift(z=0.2)
    pose = look_at((0.0, -0.6, 0.2), (0, 0, 0.2))
    depth, _ = render(Shape("wire", wire | Box((0.3, 0.02, 0.3)).shift(y=0.3)), pose, CAMERA, plane=False)
    angle = np.linspace(0, 2 * math.pi, 400, endpoint=False)
    points = np.stack([0.1 * np.cos(angle), np.zeros(400), 0.2 + 0.1 * np.sin(angle)], axis=1).astype(np.float32)
    pixels = np.rint(project(points, pose, CAMERA)[:, :2]).astype(int)
    assert (np.abs(depth[pixels[:, 1], pixels[:, 0]] - 0.6) < 0.005).mean() > 0.97


def test_every_pixel_lies_on_the_surface() -> None:
    for family in ("mug", "animal", "csg", "chair", "bowl"):
        shape = sample_shape(family, np.random.default_rng(3), thin=True).moved(0.4, 0.2)
        pose = look_at((0.6, 0.3, 0.4), (0, 0, 0.1))
        depth, mask = render(shape, pose, CAMERA)
        eye, directions = rays(pose, CAMERA)
        points = (eye + depth[mask][:, None] * directions[mask]).astype(np.float32)
        assert mask.sum() > 2000
        assert np.quantile(np.abs(shape.distance(points)), 0.995) < 2e-5
        # Nothing of the body lies before it: 50 points between the eye and the surface are outside.
        for fraction in np.linspace(0.3, 0.995, 50):
            between = (eye + fraction * depth[mask][:, None] * directions[mask]).astype(np.float32)
            assert (shape.distance(between) > -1e-5).mean() > 0.999


def test_clutter_in_front_hides_a_part_of_the_object() -> None:
    shape, other = stand("box", Box((0.1, 0.1, 0.1))), stand("box", Box((0.04, 0.04, 0.08)))
    pose = look_at((0.9, 0.0, 0.35), (0, 0, 0.05))
    front = place_clutter(shape, other, pose, np.random.default_rng(0), occlude=True)
    alone, cluttered = render(shape, pose, CAMERA), render(shape, pose, CAMERA, clutter=(front,))
    hidden = alone.mask & ~cluttered.mask
    assert 100 < hidden.sum() < alone.mask.sum()
    assert (cluttered.depth_m[hidden] < alone.depth_m[hidden]).all()
    assert np.array_equal(cluttered.depth_m[cluttered.mask], alone.depth_m[cluttered.mask])


def test_clutter_never_cuts_into_the_object() -> None:
    rng = np.random.default_rng(4)
    shape = stand("box", Box((0.1, 0.05, 0.1))).moved(0.3)
    for occlude in (False, True):
        for _ in range(10):
            other = sample_shape("tower", rng).moved(rng.uniform(0, 6), 0.1)
            placed = place_clutter(shape, other, look_at(EYE, (0, 0, 0)), rng, occlude)
            points = rng.uniform(placed.bounds[:, 0], placed.bounds[:, 1], (4000, 3)).astype(np.float32)
            assert not ((placed.distance(points) < 0) & (shape.distance(points) < 0)).any()
            assert tight_bounds(placed)[2, 0] == pytest.approx(0, abs=1e-3)


def test_an_object_behind_the_camera_or_beyond_its_range_is_not_seen() -> None:
    pose = look_at((1, 0, 0.3), (2, 0, 0.2))
    depth, mask = render(stand("box", Box((0.1, 0.1, 0.1))), pose, CAMERA)
    assert not mask.any()
    assert np.isfinite(depth).any()
    far = render(stand("box", Box((0.1, 0.1, 0.1))), look_at((9, 0, 3), (0, 0, 0.1)), CAMERA)
    assert not far.mask.any()


def test_look_at_puts_the_target_in_the_middle_and_up_up() -> None:
    pose = look_at((1, 2, 3), (0.1, 0.2, 0.3))
    middle, above = project(np.array([[0.1, 0.2, 0.3], [0.1, 0.2, 0.4]], np.float32), pose, CAMERA)
    np.testing.assert_allclose(middle[:2], [CAMERA.cx, CAMERA.cy], atol=1e-3)
    assert middle[2] == pytest.approx(math.dist((1, 2, 3), (0.1, 0.2, 0.3)), rel=1e-6)
    assert above[0] == pytest.approx(CAMERA.cx, abs=1e-3)
    assert above[1] < CAMERA.cy
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(pose[:3, :3]) == pytest.approx(1)


def test_look_at_refuses_straight_down() -> None:
    with pytest.raises(ValueError, match="tilt"):
        look_at((0, 0, 1), (0, 0, 0))


def test_viewpoints_frame_the_object_at_the_stated_size_and_elevation() -> None:
    rng = np.random.default_rng(6)
    bounds = np.array([[-0.1, 0.1], [-0.06, 0.06], [0, 0.15]])
    spans, elevations, centres = [], [], []
    for _ in range(300):
        pose, intrinsics = sample_viewpoint(bounds, rng)
        corners = np.stack(np.meshgrid(*bounds, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)
        pixels = project(corners, pose, intrinsics)
        assert (pixels[:, 2] > 0.1).all()
        assert (pixels[:, :2] >= 0).all() and (pixels[:, 0] < 640).all() and (pixels[:, 1] < 480).all()
        assert 500 <= intrinsics.fx <= 920
        eye = invert_rigid(pose)[:3, 3] - bounds.mean(axis=1)
        elevations.append(math.degrees(math.asin(eye[2] / np.linalg.norm(eye))))
        spans.append(np.ptp(pixels[:, :2], axis=0).max())
        centres.append(pixels[:, :2].mean(axis=0))
    assert 4.9 < min(elevations) and max(elevations) < 85.1
    assert np.mean([15 <= e <= 60 for e in elevations]) > 0.8
    assert 45 < np.quantile(spans, 0.02) and np.quantile(spans, 0.98) < 330
    assert np.std(centres, axis=0).min() > 30  # not always in the middle
