"""Which plane carries the object, where several are seen."""

from __future__ import annotations

import numpy as np
import pytest

from service.core.support_plane import SupportPlane, find_support_plane, level_plane

RNG = np.random.default_rng(11)
UP = np.array([0.0, -0.8, -0.6])


def plane_points(normal: np.ndarray, offset_m: float, count: int, noise_m: float = 0.0005) -> np.ndarray:
    """Points of a plane in front of the camera, at depths of 0.4 to 1.2 m."""
    z = RNG.uniform(0.4, 1.2, count)
    x = RNG.uniform(-0.5, 0.5, count) * z
    y = -(offset_m + normal[0] * x + normal[2] * z) / normal[1]
    points = np.stack([x, y, z], axis=1) + RNG.normal(0.0, noise_m, (count, 1)) * normal
    return points.astype(np.float32)


def even(points: np.ndarray) -> np.ndarray:
    return np.ones(len(points), np.float32)


NOTHING = np.empty((0, 3), np.float32)


def angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(min(1.0, abs(float(a @ b))))))


def test_normal_is_the_axis_of_least_variance() -> None:
    points = plane_points(UP, 0.4, 3000)
    plane = find_support_plane(points, even(points), NOTHING)
    assert plane is not None
    on = points[np.abs(plane.heights_m(points)) < 0.002].astype(np.float64)
    assert len(on) > 2990  # four times the noise
    axes = np.linalg.eigh(np.cov(on.T)).eigenvectors
    assert angle_deg(plane.normal, axes[:, 0]) < 1e-3
    assert plane.normal @ UP > 0.99


def test_plane_is_found_among_sixty_percent_outliers() -> None:
    clutter = RNG.uniform([-0.5, -0.9, 0.4], [0.5, 0.05, 1.2], (1500, 3)).astype(np.float32)
    clutter = clutter[clutter @ UP + 0.4 > 0.0]
    points = np.concatenate([plane_points(UP, 0.4, len(clutter) * 2 // 3), clutter])
    plane = find_support_plane(points, even(points), NOTHING)
    assert plane is not None
    assert angle_deg(plane.normal, UP) < 0.5
    assert plane.offset_m == pytest.approx(0.4, abs=0.002)


def test_normal_points_to_the_side_of_the_camera() -> None:
    points = plane_points(-UP, -0.4, 1000)
    plane = find_support_plane(points, even(points), NOTHING)
    assert plane is not None
    assert float(plane.normal @ UP) > 0.999
    assert plane.offset_m > 0


def test_same_points_give_the_same_plane() -> None:
    points = plane_points(UP, 0.4, 1000)
    first, again = (find_support_plane(points, even(points), NOTHING) for _ in range(2))
    assert first is not None and again is not None
    np.testing.assert_array_equal(first.normal, again.normal)
    assert first.offset_m == again.offset_m


def test_larger_plane_above_another_does_not_win() -> None:
    """A shelf hides none of the table below it: what is seen below a plane speaks against it."""
    shelf, table = plane_points(UP, 0.2, 1200), plane_points(UP, 0.4, 1000)
    points = np.concatenate([shelf, table])
    plane = find_support_plane(points, even(points), NOTHING)
    assert plane is not None
    assert plane.offset_m == pytest.approx(0.4, abs=0.002)


def wall_points(count: int) -> np.ndarray:
    """A wall 1.1 m in front of the camera, down to the table."""
    z = np.full(count, 1.1)
    points = np.stack([RNG.uniform(-0.5, 0.5, count), RNG.uniform(-0.9, -0.3, count), z], axis=1)
    assert (points @ UP + 0.4 > -0.03).all()
    return points.astype(np.float32)


def test_plane_that_the_object_would_be_behind_is_not_its_support() -> None:
    wall, table = wall_points(3000), plane_points(UP, 0.4, 1000)
    points = np.concatenate([wall, table])
    alone = find_support_plane(points, even(points), NOTHING)
    assert alone is not None
    assert angle_deg(alone.normal, np.array([0.0, 0.0, -1.0])) < 1.0
    behind_the_wall = np.array([[0.0, -0.9, 1.3]], np.float32)
    plane = find_support_plane(points, even(points), behind_the_wall)
    assert plane is not None
    assert angle_deg(plane.normal, UP) < 0.5


def test_given_up_rules_out_a_larger_wall() -> None:
    points = np.concatenate([wall_points(3000), plane_points(UP, 0.4, 800)])
    plane = find_support_plane(points, even(points), NOTHING, UP)
    assert plane is not None
    assert angle_deg(plane.normal, UP) < 0.5


def test_plane_far_from_level_is_none_where_up_is_known() -> None:
    points = plane_points(UP, 0.4, 1000)
    assert find_support_plane(points, even(points), NOTHING, np.array([1.0, 0.0, 0.0])) is None


def test_round_object_alone_holds_no_plane() -> None:
    # One point a pixel: even across the disc that the camera sees.
    x, y = RNG.uniform(-0.1, 0.1, (2, 4000))
    inside = np.hypot(x, y) < 0.1
    x, y = x[inside], y[inside]
    ball = np.stack([x, y, 0.8 - np.sqrt(0.01 - x**2 - y**2)], axis=1).astype(np.float32)
    assert find_support_plane(ball, even(ball), NOTHING) is None


def test_too_few_points_hold_no_plane() -> None:
    points = plane_points(UP, 0.4, 30)
    assert find_support_plane(points, even(points), NOTHING) is None


@pytest.mark.parametrize(("tilt_deg", "keeps_given"), [(0.5, True), (3.0, False)])
def test_given_up_is_kept_only_where_it_agrees(tilt_deg: float, keeps_given: bool) -> None:
    points = plane_points(UP, 0.4, 1000)
    tilt = np.radians(tilt_deg)
    given = np.cos(tilt) * UP + np.sin(tilt) * np.array([1.0, 0.0, 0.0])
    plane = level_plane(SupportPlane(UP, 0.4), given, points, even(points))
    np.testing.assert_allclose(plane.normal, given if keeps_given else UP)
    assert np.abs(np.average(plane.heights_m(points))) < 0.001
