"""Rays, back-projection and their inverse, and what a bad camera is told."""

from __future__ import annotations

import numpy as np
import pytest

from service.core import camera
from service.core.camera import Intrinsics, back_project, make_intrinsics, parse_up, pixel_to_point, project
from service.core.errors import InvalidCamera, InvalidRequest

PLAIN = make_intrinsics(615.0, 610.0, 320.5, 238.0, 640, 480)
DISTORTED = make_intrinsics(615.0, 610.0, 320.5, 238.0, 640, 480, (0.12, -0.25, 0.001, -0.002, 0.05))


def sloped_depth() -> np.ndarray:
    v, u = np.mgrid[:480, :640]
    return (0.5 + 0.0005 * u + 0.0003 * v).astype(np.float32)


@pytest.mark.parametrize("intrinsics", [PLAIN, DISTORTED], ids=["plain", "distorted"])
def test_projection_inverts_back_projection(intrinsics: Intrinsics) -> None:
    depth_m = sloped_depth()
    depth_m[100:200] = np.nan
    v, u = np.nonzero(np.isfinite(depth_m))
    points = back_project(depth_m, intrinsics)
    pixels, z_m = project(points, intrinsics)
    assert points.dtype == np.float32
    assert np.abs(pixels - np.stack([u, v], axis=1)).max() < 1e-3
    np.testing.assert_array_equal(z_m, depth_m[v, u])


def test_back_projection_is_the_pinhole_formula() -> None:
    depth_m = np.full((480, 640), np.nan, np.float32)
    depth_m[30, 40] = 2.0
    expected = [[(40 - 320.5) / 615 * 2, (30 - 238) / 610 * 2, 2.0]]
    np.testing.assert_allclose(back_project(depth_m, PLAIN), expected, rtol=1e-6)


def test_mask_limits_the_points() -> None:
    mask = np.zeros((480, 640), bool)
    mask[10:12, 20:25] = True
    depth_m = sloped_depth()
    depth_m[10, 20] = np.nan
    assert len(back_project(depth_m, PLAIN, mask)) == 9


def test_pixels_beyond_the_fold_of_the_lens_model_give_no_points() -> None:
    # r(1 − 0.5 r²) has its maximum at r = 0.816, so pixels farther out than 0.544 focal lengths have no ray.
    folding = make_intrinsics(300.0, 300.0, 320.0, 240.0, 640, 480, (-0.5, 0.0, 0.0, 0.0))
    points = back_project(np.ones((480, 640), np.float32), folding)
    v, u = np.mgrid[:480, :640]
    radius = np.hypot(u - 320, v - 240) / 300
    assert (radius < 0.52).sum() <= len(points) <= (radius < 0.56).sum()
    assert np.isfinite(points).all()


def test_points_behind_the_camera_have_no_pixel() -> None:
    pixels, z_m = project(np.array([[0, 0, -1], [0, 0, 1]], np.float32), PLAIN)
    assert np.isnan(pixels[0]).all()
    np.testing.assert_allclose(pixels[1], [320.5, 238.0])
    np.testing.assert_array_equal(z_m, [-1, 1])


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"fx": 0.0}, "camera.fx"),
        ({"fx": float("nan")}, "camera.fx"),
        ({"fy": -600.0}, "camera.fy"),
        ({"cx": float("inf")}, "camera.cx"),
        ({"cy": float("nan")}, "camera.cy"),
        ({"width": 0}, "camera.width"),
        ({"height": -480}, "camera.height"),
        ({"distortion": (0.1, 0.2, 0.3)}, "camera.distortion"),
        ({"distortion": (0.1, float("nan"), 0.0, 0.0)}, "camera.distortion[1]"),
    ],
)
def test_unusable_cameras_are_refused_by_field(change: dict[str, object], field: str) -> None:
    good = {"fx": 600.0, "fy": 600.0, "cx": 320.0, "cy": 240.0, "width": 640, "height": 480}
    with pytest.raises(InvalidCamera) as caught:
        make_intrinsics(**{**good, **change})  # type: ignore[arg-type]
    assert caught.value.field == field


def test_zero_distortion_counts_as_none() -> None:
    assert make_intrinsics(600.0, 600.0, 320.0, 240.0, 640, 480, (0.0,) * 5).distortion is None


def test_up_is_made_a_unit_vector() -> None:
    np.testing.assert_allclose(parse_up([0.0, -9.0, -12.0]), [0.0, -0.6, -0.8])


@pytest.mark.parametrize("up", [(0.0, 0.0, 0.0), (0.0, float("nan"), 1.0), (0.0, float("inf"), 1.0), (1.0, 0.0)])
def test_unusable_up_is_refused(up: tuple[float, ...]) -> None:
    with pytest.raises(InvalidCamera) as caught:
        parse_up(up)
    assert caught.value.field == "up"


@pytest.mark.parametrize("intrinsics", [PLAIN, DISTORTED], ids=["plain", "distorted"])
def test_pixel_to_point_projects_back_to_the_pixel(intrinsics: Intrinsics) -> None:
    point = pixel_to_point(400.0, 100.0, sloped_depth(), intrinsics)
    pixels, _ = project(point[None].astype(np.float32), intrinsics)
    np.testing.assert_allclose(pixels[0], [400.0, 100.0], atol=1e-3)
    assert point[2] == pytest.approx(0.5 + 0.0005 * 400 + 0.0003 * 100)


def test_a_hole_at_the_pixel_is_bridged_by_the_median_around_it() -> None:
    depth_m = np.full((480, 640), 0.6, np.float32)
    depth_m[198:203, 298:303] = np.nan
    depth_m[197, 297] = 3.0  # one flying pixel must not count
    np.testing.assert_allclose(pixel_to_point(300.0, 200.0, depth_m, PLAIN)[2], 0.6, rtol=1e-6)


def test_the_bridge_reads_only_pixels_of_the_mask() -> None:
    depth_m = np.full((480, 640), 0.6, np.float32)
    depth_m[200, 300] = np.nan
    depth_m[:, 302:] = 0.4
    mask = np.zeros((480, 640), bool)
    mask[:, 302:] = True
    np.testing.assert_allclose(pixel_to_point(300.0, 200.0, depth_m, PLAIN, mask=mask)[2], 0.4, rtol=1e-6)


@pytest.mark.parametrize(("u", "v"), [(-1.0, 5.0), (640.0, 5.0), (5.0, 480.0), (float("nan"), 5.0)])
def test_pixels_outside_the_image_are_refused(u: float, v: float) -> None:
    with pytest.raises(InvalidRequest) as caught:
        pixel_to_point(u, v, sloped_depth(), PLAIN, field="loads[0].contact_px")
    assert caught.value.field == "loads[0].contact_px"


def test_a_pixel_far_from_any_reading_is_refused() -> None:
    depth_m = np.full((480, 640), np.nan, np.float32)
    depth_m[0, 0] = 0.5
    with pytest.raises(InvalidRequest, match="no reading near"):
        pixel_to_point(300.0, 200.0, depth_m, PLAIN)


def test_rays_are_computed_once_for_a_camera() -> None:
    first = camera.ray_grid(PLAIN)
    again = camera.ray_grid(make_intrinsics(615.0, 610.0, 320.5, 238.0, 640, 480))
    assert first[0] is again[0]
    assert not first[0].flags.writeable
