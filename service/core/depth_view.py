"""A window of a depth image, thinned out, with the rays of its pixels: what the segmentation looks at."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float32, Int64

from service.core.arrays import DepthImage, Mask, Points, Vector3
from service.core.camera import Intrinsics, ray_grid

Window: TypeAlias = tuple[slice, slice]
"""Rows and columns of an image."""

WHOLE_IMAGE: Window = (slice(None), slice(None))

JUMP_M = 0.008
"""A step in depth from one pixel to the next that no surface seen at a usable angle makes, metres."""

JUMP_PER_DEPTH = 0.015
"""The same per metre of depth, where that is more: pixels lie farther apart out there."""


@dataclass(frozen=True)
class DepthView:
    """Every `stride`-th row and column of a window of a depth image.

    Attributes:
        z_m: Depth in metres, NaN where there is no reading.
        ray_x: x/z of the ray through each pixel.
        ray_y: y/z of the ray through each pixel.
        first_pixel: (row, column) of the upper left pixel in the image.
        stride: Distance between neighbouring pixels of the view in the image.
    """

    z_m: Float32[np.ndarray, "rows columns"]
    ray_x: Float32[np.ndarray, "rows columns"]
    ray_y: Float32[np.ndarray, "rows columns"]
    first_pixel: tuple[int, int]
    stride: int

    def heights_m(self, normal: Vector3, offset_m: float) -> Float32[np.ndarray, "rows columns"]:
        """Signed height of every reading above a plane, metres; NaN where there is no reading."""
        nx, ny, nz = (np.float32(component) for component in normal)
        heights_m = nx * self.ray_x
        heights_m += ny * self.ray_y
        heights_m += nz
        heights_m *= self.z_m
        heights_m += np.float32(offset_m)
        return heights_m

    def points(self, where: Bool[np.ndarray, "rows columns"]) -> Points:
        """Points of the chosen readings in row-major order, camera frame, metres."""
        chosen = np.flatnonzero(where)
        points = np.empty((len(chosen), 3), np.float32)
        z_m = self.z_m.ravel()[chosen]
        np.multiply(self.ray_x.ravel()[chosen], z_m, out=points[:, 0])
        np.multiply(self.ray_y.ravel()[chosen], z_m, out=points[:, 1])
        points[:, 2] = z_m
        return points

    def pixels(
        self, where: Bool[np.ndarray, "rows columns"]
    ) -> tuple[Int64[np.ndarray, " n"], Int64[np.ndarray, " n"]]:
        """(rows, columns) in the whole image of the chosen readings, in row-major order."""
        rows, columns = where.shape
        # Counting along rows spares an integer division for each pixel.
        row = np.repeat(np.arange(rows), np.count_nonzero(where, axis=1))
        column = np.flatnonzero(where) - row * columns
        return row * self.stride + self.first_pixel[0], column * self.stride + self.first_pixel[1]

    def part(self, window: Window) -> DepthView:
        """A window of the view itself."""
        first_pixel = tuple(
            first + self.stride * side.start for first, side in zip(self.first_pixel, window, strict=True)
        )
        z_m, ray_x, ray_y = (np.ascontiguousarray(image[window]) for image in (self.z_m, self.ray_x, self.ray_y))
        return DepthView(z_m, ray_x, ray_y, (first_pixel[0], first_pixel[1]), self.stride)

    def crop(self, mask: Mask) -> Bool[np.ndarray, "rows columns"]:
        """The view's own pixels of a mask of the whole image."""
        rows, columns = self.z_m.shape
        row, column = self.first_pixel
        return mask[
            row : row + (rows - 1) * self.stride + 1 : self.stride,
            column : column + (columns - 1) * self.stride + 1 : self.stride,
        ]


def view_depth(depth_m: DepthImage, intrinsics: Intrinsics, window: Window = WHOLE_IMAGE, stride: int = 1) -> DepthView:
    """Look at a window of a depth image; an empty window gives an empty view."""
    rows, columns = (side.indices(size) for side, size in zip(window, depth_m.shape, strict=True))
    grid = (slice(rows[0], rows[1], stride), slice(columns[0], columns[1], stride))
    if window == WHOLE_IMAGE:
        ray_x, ray_y = _thinned_rays(intrinsics, stride)
    else:
        ray_x, ray_y = (np.ascontiguousarray(image[grid]) for image in ray_grid(intrinsics))
    return DepthView(np.ascontiguousarray(depth_m[grid]), ray_x, ray_y, (rows[0], columns[0]), stride)


@lru_cache(maxsize=8)
def _thinned_rays(
    intrinsics: Intrinsics, stride: int
) -> tuple[Float32[np.ndarray, "rows columns"], Float32[np.ndarray, "rows columns"]]:
    """Rays of every `stride`-th pixel, gathered once for a camera: strided reads cost more than the arithmetic."""
    ray_x, ray_y = (np.ascontiguousarray(image[::stride, ::stride]) for image in ray_grid(intrinsics))
    ray_x.flags.writeable = False
    ray_y.flags.writeable = False
    return ray_x, ray_y


def on_surface(z_m: Float32[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """Readings that lie on a surface, and do not hang in the air between two as sensors report at edges.

    A reading on a surface has a neighbour at its own depth, and is not on a ramp that jumps before it and after it.
    """
    jump_m = np.maximum(np.float32(JUMP_M), np.float32(JUMP_PER_DEPTH) * z_m)
    has_level_neighbour = np.zeros(z_m.shape, np.bool_)
    on_ramp = np.zeros(z_m.shape, np.bool_)
    # Comparisons with NaN are false: a hole is neither a level neighbour nor a jump.
    for before, after in (
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
    ):
        step_m = z_m[after] - z_m[before]
        jump_here_m = jump_m[after]
        rises = step_m > jump_here_m
        level = np.abs(step_m, out=step_m) <= jump_here_m
        jumps = step_m > jump_here_m
        has_level_neighbour[after] |= level
        has_level_neighbour[before] |= level
        # The step into a pixel and the step out of it, both jumps in one direction: the inner pixels of both arrays.
        one_way = jumps[before] & jumps[after]
        one_way &= rises[before] == rises[after]
        on_ramp[after][before] |= one_way
    return has_level_neighbour & ~on_ramp


def window_around(shown: Bool[np.ndarray, "rows columns"], margin: float = 0.0, margin_px: int = 0) -> Window:
    """Box around the set pixels of an image (at least one), wider on each side by a share of itself and some pixels."""
    sides = []
    for axis in (1, 0):
        places = np.flatnonzero(shown.any(axis=axis))
        first, last = int(places[0]), int(places[-1])
        more = max(margin_px, round(margin * (last - first + 1)))
        sides.append(slice(max(first - more, 0), min(last + more + 1, shown.shape[1 - axis])))
    return sides[0], sides[1]
