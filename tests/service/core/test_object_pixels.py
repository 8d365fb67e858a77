"""An object's pixels, all at once, against the parts that tell them one after the other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.core.depth_view import on_surface, view_depth, window_around
from service.core.footprints import find_footprints
from service.core.object_pixels import standing_in
from service.core.support_plane import SupportPlane
from service.core.surroundings import Support
from tests.synthetic_scenes import CAMERA, Box, render

BOXES = [Box((-0.12, -0.05, 0.0), (-0.04, 0.05, 0.1)), Box((0.04, -0.05, 0.0), (0.12, 0.05, 0.1))]
WINDOW = (slice(60, 420), slice(80, 560))


@pytest.mark.parametrize("distortion", [None, (0.05, -0.02, 0.001, -0.001, 0.0)])
@pytest.mark.parametrize("supported", [True, False])
@pytest.mark.parametrize("window", [WINDOW, (slice(200, 201), slice(250, 420)), (slice(0, 480), slice(0, 640))])
def test_pixels_are_those_of_its_parts(
    distortion: tuple[float, ...] | None, supported: bool, window: tuple[slice, slice]
) -> None:
    scene = render(BOXES)
    depth_m = scene.depth_m.copy()
    rng = np.random.default_rng(0)
    depth_m[rng.random(depth_m.shape) < 0.05] = np.nan
    depth_m[rng.random(depth_m.shape) < 0.02] += 0.05
    camera = replace(CAMERA, distortion=distortion)
    view = view_depth(depth_m, camera, window)
    plane = SupportPlane(scene.up, scene.offset_m)
    support = Support(plane, plane) if supported else None
    whole = view_depth(depth_m, camera)
    points = whole.points((scene.shown >= 0) & np.isfinite(depth_m))
    footprints = find_footprints(points, scene.up, points[0].astype(np.float64))
    assert footprints is not None

    rising = on_surface(view.z_m)
    if support is not None:
        rising &= support.clearance(view) > 1.0
    labels = np.zeros(rising.shape, np.int32)
    labels[rising] = footprints.label_of(view.points(rising))
    label = int(np.argmax(np.bincount(labels.ravel())[1:])) + 1
    expected = labels == label
    assert 30 < expected.sum() < np.isfinite(view.z_m).sum()

    found, shown, around = standing_in(depth_m, camera, window, support, footprints, label)
    np.testing.assert_array_equal(shown, expected)
    np.testing.assert_array_equal(found, view.points(expected))
    assert around == window_around(expected)


def test_nothing_stands_in_an_empty_window() -> None:
    scene = render(BOXES)
    points = view_depth(scene.depth_m, CAMERA).points(scene.shown >= 0)
    footprints = find_footprints(points, scene.up, points[0].astype(np.float64))
    assert footprints is not None
    found, shown, around = standing_in(scene.depth_m, CAMERA, (slice(5, 5), slice(0, 100)), None, footprints, 1)
    assert found.shape == (0, 3)
    assert shown.shape == (0, 100)
    assert shown[around].size == 0
