"""Clearances above the support, and distances from a place."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.core.depth_view import WHOLE_IMAGE, Window, view_depth, window_around
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


@pytest.mark.parametrize("window", [WHOLE_IMAGE, (slice(11, 400), slice(60, 335))], ids=["all", "part"])
@pytest.mark.parametrize("distortion", [None, (0.02, -0.01, 0.001, 0.002)], ids=["rectified", "distorted"])
def test_the_window_above_is_the_box_around_what_rises_and_one_pixel_more(
    window: Window, distortion: tuple[float, ...] | None
) -> None:
    camera = replace(CAMERA, distortion=distortion)
    support = Support(SupportPlane(SCENE.up, SCENE.offset_m), SupportPlane(SCENE.up, SCENE.offset_m))
    view = view_depth(SCENE.depth_m, camera, window, 3)
    rows, columns = window_around(support.clearance(view) > 1.0, margin_px=1)
    assert 20 < rows.stop - rows.start < view.z_m.shape[0]
    assert 20 < columns.stop - columns.start < view.z_m.shape[1]
    found = support.window_above(SCENE.depth_m, camera, window, 3)
    assert found is not None
    part = view_depth(SCENE.depth_m, camera, found, 3)
    assert part.first_pixel == (view.first_pixel[0] + 3 * rows.start, view.first_pixel[1] + 3 * columns.start)
    np.testing.assert_array_equal(part.z_m, view.z_m[rows, columns])


def test_nothing_rises_above_a_bare_table() -> None:
    support = Support(SupportPlane(SCENE.up, SCENE.offset_m), SupportPlane(SCENE.up, SCENE.offset_m))
    assert support.window_above(SCENE.depth_m, CAMERA, (slice(430, 480), WHOLE_IMAGE[1]), 2) is None


def test_distances_are_euclidean() -> None:
    points = np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32)
    place = np.array([0.1, -0.2, 0.7])
    np.testing.assert_allclose(distances_m(points, place), np.linalg.norm(points - place, axis=1), rtol=1e-5)
