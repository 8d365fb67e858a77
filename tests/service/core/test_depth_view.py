"""Windows of a depth image, and the readings that hang in the air."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from service.core.camera import back_project, ray_grid
from service.core.depth_view import JUMP_M, JUMP_PER_DEPTH, narrowed, on_surface, view_depth, window_around
from tests.synthetic_scenes import CAMERA, Box, render

SCENE = render([Box((-0.05, -0.05, 0.0), (0.05, 0.05, 0.1))])


def test_points_of_a_whole_view_are_those_of_the_camera() -> None:
    view = view_depth(SCENE.depth_m, CAMERA)
    readable = np.isfinite(view.z_m)
    np.testing.assert_array_equal(view.points(readable), back_project(SCENE.depth_m, CAMERA))


@pytest.mark.parametrize("distortion", [None, (0.1, -0.05, 0.001, 0.002)])
def test_rays_of_a_window_are_those_of_its_pixels(distortion: tuple[float, ...] | None) -> None:
    camera = replace(CAMERA, distortion=distortion)
    view = view_depth(SCENE.depth_m, camera, (slice(100, 300), slice(50, 400)), 3)
    for ray, whole in zip((view.ray_x, view.ray_y), ray_grid(camera), strict=True):
        np.testing.assert_array_equal(ray, whole[100:300:3, 50:400:3])


def test_thinned_window_reads_the_pixels_it_names() -> None:
    window = (slice(100, 300), slice(50, 400))
    view = view_depth(SCENE.depth_m, CAMERA, window, 3)
    where = view.crop(SCENE.shown == 0)
    row, column = np.nonzero(SCENE.shown[100:300:3, 50:400:3] == 0)
    row, column = 100 + 3 * row, 50 + 3 * column
    assert len(row) > 100
    np.testing.assert_array_equal(view.points(where)[:, 2], SCENE.depth_m[row, column])
    distances_px = np.hypot(row - 200.5, column - 300.0)
    np.testing.assert_allclose(view.distances_px(where, 200.5, 300.0), distances_px, rtol=1e-6)


def test_what_is_kept_of_set_pixels_is_counted_in_row_major_order() -> None:
    where = np.random.default_rng(0).random((20, 30)) < 0.5
    kept = np.random.default_rng(1).random(where.sum()) < 0.5
    expected = np.zeros_like(where)
    expected[where] = kept
    np.testing.assert_array_equal(narrowed(where, kept), expected)


def test_window_around_a_mask_is_cut_at_the_border() -> None:
    mask = np.zeros((480, 640), bool)
    mask[2:12, 600:640] = True
    assert window_around(mask) == (slice(2, 12), slice(600, 640))
    assert window_around(mask, margin=0.5, margin_px=8) == (slice(0, 20), slice(580, 640))


def test_pixels_between_two_surfaces_are_not_on_one() -> None:
    z_m = np.full((20, 20), 0.6, np.float32)
    z_m[:, 10:] = 0.9
    z_m[:, 10] = 0.7  # a smeared edge
    assert on_surface(z_m)[:, :10].all()
    assert not on_surface(z_m)[:, 10].any()
    assert on_surface(z_m)[:, 11:].all()


def test_lone_pixels_and_holes_are_not_on_a_surface() -> None:
    z_m = np.full((20, 20), 0.6, np.float32)
    z_m[5, 5], z_m[8, 8] = 0.3, np.nan
    surface = on_surface(z_m)
    assert not surface[5, 5]
    assert not surface[8, 8]
    assert surface.sum() == 398


def test_a_surface_is_what_the_definition_says_pixel_by_pixel() -> None:
    rng = np.random.default_rng(3)
    z_m = (0.6 + 0.008 * rng.integers(0, 8, (30, 40))).astype(np.float32)
    z_m[rng.random(z_m.shape) < 0.2] = np.nan
    # A border of holes, so that every pixel has four neighbours; each step is judged by the reading it ends at.
    z = np.pad(z_m, 1, constant_values=np.nan)
    level, ramp = np.zeros(z_m.shape, bool), np.zeros(z_m.shape, bool)
    for before, after in (
        (z[1:-1, :-2], z[1:-1, 2:]),
        (z[:-2, 1:-1], z[2:, 1:-1]),
    ):
        into, out = z_m - before, after - z_m
        jump_into, jump_out = (np.maximum(np.float32(JUMP_M), np.float32(JUMP_PER_DEPTH) * end) for end in (z_m, after))
        level |= (abs(into) <= jump_into) | (abs(out) <= jump_out)
        ramp |= (abs(into) > jump_into) & (abs(out) > jump_out) & (np.sign(into) == np.sign(out))
    np.testing.assert_array_equal(on_surface(z_m), level & ~ramp)
    assert 100 < (level & ~ramp).sum() < 1100


def test_thin_rod_is_a_surface() -> None:
    z_m = np.full((20, 20), 0.9, np.float32)
    z_m[:, 7] = 0.6
    assert on_surface(z_m).all()
