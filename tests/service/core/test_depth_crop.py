"""Contacts as pixels are the same points in the window around an object as in its whole image."""

from dataclasses import replace

import numpy as np
import pytest

from service.core.camera import pixel_to_point
from service.core.depth_crop import crop_around
from service.core.errors import InvalidRequest
from service.core.segmentation import segment
from tests.synthetic_scenes import CAMERA, Box, render

SCENE = render([Box((-0.05, -0.04, 0.0), (0.05, 0.04, 0.14))], noise_m=0.0005)
DEPTH_M = np.where(np.random.default_rng(1).random(SCENE.depth_m.shape) < 0.05, np.float32(np.nan), SCENE.depth_m)
FOUND = segment(DEPTH_M, CAMERA, up=SCENE.up)

LENS = replace(CAMERA, distortion=(0.05, -0.02, 0.001, 0.0))


@pytest.mark.parametrize("camera", [CAMERA, LENS], ids=["plain", "lens"])
def test_a_pixel_on_or_near_the_object_is_the_same_point(camera):
    crop = crop_around(FOUND.box, DEPTH_M, camera)
    rows, columns = np.nonzero(FOUND.pixels)
    near = int(0.25 * (columns.max() - columns.min()))
    for u, v in (
        (columns.mean(), rows.mean()),
        (columns.min() - near, rows.max() + near),
        (columns.max() + near - 0.4, rows.min() - near + 0.3),
    ):
        u, v = float(u), float(v)
        expected = pixel_to_point(u, v, DEPTH_M, camera)
        np.testing.assert_array_equal(crop.point(u, v, "loads[0].contact_px"), expected)


def test_it_is_a_copy_of_a_part():
    crop = crop_around(FOUND.box, DEPTH_M, CAMERA)
    assert crop.depth_m.base is None
    assert crop.depth_m.size < DEPTH_M.size
    (left, top), (rows, columns) = crop.corner_px, crop.depth_m.shape
    np.testing.assert_array_equal(crop.depth_m, DEPTH_M[top : top + rows, left : left + columns])
    assert (FOUND.pixels[top : top + rows, left : left + columns]).sum() == FOUND.pixels.sum()


def test_a_pixel_that_was_not_kept_is_told_so_with_what_was():
    crop = crop_around((slice(100, 110), slice(200, 220)), DEPTH_M, CAMERA)
    with pytest.raises(InvalidRequest, match="surroundings") as refused:
        crop.point(10.0, 10.0, "loads[2].contact_px")
    assert refused.value.field == "loads[2].contact_px"
    assert refused.value.expected == "u in [173, 246], v in [73, 136]"


@pytest.mark.parametrize("pixel", [(-1.0, 10.0), (float("nan"), 10.0), (10.0, 1e9)])
def test_a_pixel_outside_the_image_is_refused_as_in_the_whole_image(pixel):
    crop = crop_around(FOUND.box, DEPTH_M, CAMERA)
    with pytest.raises(InvalidRequest, match="outside the image"):
        crop.point(*pixel, "loads[0].contact_px")
