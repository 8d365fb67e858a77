"""Objects told apart as seen from above."""

from __future__ import annotations

import numpy as np

from service.core.depth_view import DepthView, view_depth
from service.core.footprints import Footprints, NearestFootprint, find_footprints, nearest_footprint
from tests.synthetic_scenes import CAMERA, Box, render

UP = np.array([0.0, -1.0, 0.0])
PLACE = np.array([0.0, 0.0, 0.6])


def block(x0: float, x1: float, z0: float, z1: float, height_m: float = 0.05) -> np.ndarray:
    """Points of a solid standing on y = 0, one every 2 mm."""
    x, z, y = np.meshgrid(np.arange(x0, x1, 0.002), np.arange(z0, z1, 0.002), np.arange(0, height_m, 0.01))
    return np.stack([x.ravel(), -y.ravel(), z.ravel()], axis=1).astype(np.float32)


def arc(first_deg: float, last_deg: float, radius_m: float = 0.06) -> np.ndarray:
    angle = np.radians(np.arange(first_deg, last_deg, 0.5))
    ring = np.stack([radius_m * np.cos(angle), np.zeros_like(angle), 0.6 + radius_m * np.sin(angle)], axis=1)
    return ring.astype(np.float32)


def find(*parts: np.ndarray) -> Footprints:
    footprints = find_footprints(np.concatenate(parts), UP, PLACE)
    assert footprints is not None
    return footprints


def test_blocks_apart_are_two_objects() -> None:
    left, right = block(-0.08, -0.02, 0.55, 0.6), block(0.02, 0.08, 0.55, 0.6)
    footprints = find(left, right)
    assert len(set(footprints.label_of(left))) == 1
    assert len(set(footprints.label_of(right))) == 1
    assert footprints.label_of(left)[0] != footprints.label_of(right)[0]


def test_hole_of_a_few_millimetres_does_not_split() -> None:
    left, right = block(-0.08, 0.0, 0.55, 0.6), block(0.007, 0.08, 0.55, 0.6)
    footprints = find(left, right)
    assert len(set(footprints.label_of(np.concatenate([left, right])))) == 1


def test_near_and_far_wall_of_a_cup_are_one_object() -> None:
    far, near = arc(15, 165), arc(195, 345)  # 24 mm apart at either side
    footprints = find(far, near)
    assert footprints.label_of(far)[0] == footprints.label_of(near)[0] > 0
    assert footprints.label_of(PLACE[None].astype(np.float32))[0] == footprints.label_of(near)[0]


def test_half_a_ring_joins_nothing() -> None:
    near, beside = arc(195, 345), block(0.09, 0.12, 0.55, 0.6)
    footprints = find(near, beside)
    assert footprints.label_of(near)[0] != footprints.label_of(beside)[0]


def test_object_beside_a_cup_stays_apart() -> None:
    cup, beside = arc(0, 360), block(0.078, 0.12, 0.58, 0.62)
    footprints = find(cup, beside)
    assert footprints.label_of(cup)[0] != footprints.label_of(beside)[0]


def test_points_outside_the_map_have_no_footprint() -> None:
    footprints = find(block(-0.02, 0.02, 0.58, 0.62))
    far = np.array([[5, 0, 5], [-5, 0, 0.6], [0, 0, 0.7]], np.float32)
    np.testing.assert_array_equal(footprints.label_of(far), [0, 0, 0])


def test_extent_is_the_longer_side() -> None:
    points = block(-0.1, 0.1, 0.58, 0.62)
    x, y, z = points.T.copy()[:, None]
    found = nearest_footprint(DepthView(z, x / z, y / z, (0, 0), 1), np.ones(z.shape, np.bool_), UP, PLACE, PLACE, 1)
    assert found is not None
    # Closing gaps widens a footprint by a cell on each side.
    assert abs(found.extent_m - 0.2) < 3 * found.footprints.cell_m


def test_points_out_of_reach_leave_no_map() -> None:
    assert find_footprints(np.array([[9, 0, 9]], np.float32), UP, PLACE) is None


LEFT, RIGHT = Box((-0.12, -0.05, 0.0), (-0.04, 0.05, 0.1)), Box((0.04, -0.03, 0.0), (0.08, 0.03, 0.1))


def nearest(nearest_to: np.ndarray | tuple[float, float], min_points: int = 1) -> tuple[int, NearestFootprint | None]:
    """Of two boxes; the first value tells which one it is by its pixels, -1 for none."""
    scene = render([LEFT, RIGHT])
    window = slice(60, 420), slice(80, 560)
    view = view_depth(scene.depth_m, CAMERA, window, 2)
    shown = scene.shown[60:420:2, 80:560:2]
    place_m = view.points(shown >= 0)[0].astype(np.float64)
    found = nearest_footprint(view, shown >= 0, scene.up, place_m, nearest_to, min_points)
    if found is None:
        return -1, None
    (which,) = set(shown[found.box].ravel().tolist()) - {-1}
    rows, columns = np.nonzero(shown == which)
    assert found.box == (slice(rows.min(), rows.max() + 1), slice(columns.min(), columns.max() + 1))
    return which, found


def test_the_nearest_footprint_is_that_of_the_reading_nearest_to_a_point() -> None:
    scene = render([LEFT, RIGHT])
    view = view_depth(scene.depth_m, CAMERA)
    for box in (0, 1):
        middle = view.points(scene.shown == box).mean(axis=0).astype(np.float64)
        which, found = nearest(middle)
        assert which == box
        assert found is not None
        assert (found.footprints.label_of(view.points(scene.shown == box)) == found.label).mean() > 0.99


def test_the_nearest_footprint_is_that_of_the_reading_nearest_to_a_pixel() -> None:
    scene = render([LEFT, RIGHT])
    for box in (0, 1):
        rows, columns = np.nonzero(scene.shown == box)
        assert nearest((float(rows.mean()), float(columns.mean())))[0] == box


def test_the_nearest_footprint_has_enough_readings_and_is_none_where_none_has() -> None:
    scene = render([LEFT, RIGHT])
    count = [int((scene.shown[60:420:2, 80:560:2] == box).sum()) for box in (0, 1)]
    rows, columns = np.nonzero(scene.shown == 1)
    beside = float(rows.mean()), float(columns.mean())
    assert count[1] < count[0]
    assert nearest(beside, count[1])[0] == 1
    assert nearest(beside, count[1] + 1)[0] == 0
    assert nearest(beside, count[0] + 1) == (-1, None)
