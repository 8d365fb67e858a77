"""Clearances above the support, and distances from a place."""

from __future__ import annotations

import numpy as np

from service.core.depth_view import view_depth
from service.core.support_plane import SupportPlane
from service.core.surroundings import Support, distances_m
from tests.synthetic_scenes import CAMERA, Box, render

SCENE = render([Box((-0.05, -0.05, 0.0), (0.05, 0.05, 0.1))])


def test_clearance_is_the_height_in_tolerances_of_its_depth() -> None:
    plane = SupportPlane(SCENE.up, SCENE.offset_m)
    depth_m = SCENE.depth_m.copy()
    depth_m[0, 0] = np.nan
    view = view_depth(depth_m, CAMERA, stride=2)
    clearance = Support(plane, plane).clearance(view)
    assert np.isnan(clearance[0, 0])
    heights_m = clearance * np.maximum(0.003, 0.006 * view.z_m)
    assert np.nanmax(np.abs(heights_m[view.crop(SCENE.shown == -1)])) < 1e-5
    assert abs(heights_m[view.crop(SCENE.shown == 0)].max() - 0.1) < 1e-5


def test_distances_are_euclidean() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    place = np.array([0.1, -0.2, 0.7])
    np.testing.assert_allclose(distances_m(points, place), np.linalg.norm(points - place, axis=1), rtol=1e-5)
