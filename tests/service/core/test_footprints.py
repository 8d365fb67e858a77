"""Objects told apart as seen from above."""

from __future__ import annotations

import numpy as np

from service.core.footprints import Footprints, find_footprints, nearest_label

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
    footprints = find(points)
    # Closing gaps widens a footprint by a cell on each side.
    assert abs(footprints.extent_m(int(footprints.label_of(points)[0])) - 0.2) < 3 * footprints.cell_m


def test_points_out_of_reach_leave_no_map() -> None:
    assert find_footprints(np.array([[9, 0, 9]], np.float32), UP, PLACE) is None


def test_the_nearest_label_has_enough_points_and_is_none_where_none_has() -> None:
    labels = np.array([0, 3, 1, 1, 2, 2, 2], np.int32)
    distance = np.array([0.1, 0.2, 0.5, 0.4, 0.9, 0.3, 0.3], np.float32)
    assert nearest_label(labels, distance, 1) == 3
    assert nearest_label(labels, distance, 2) == 2
    assert nearest_label(labels, distance, 4) == 0
