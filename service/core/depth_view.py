"""A window of a depth image, thinned out, with the rays of its pixels: what the segmentation looks at."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Int32

from service.core.arrays import DepthImage, Mask, Points
from service.core.camera import Intrinsics, ray_grid
from service.core.compiled import compiled

Window: TypeAlias = tuple[slice, slice]
"""Rows and columns of an image."""

Box: TypeAlias = tuple[int, int, int, int]
"""First row and the one after the last, first column and the one after the last."""

Rays: TypeAlias = Float32[np.ndarray, "rows columns"]

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

    def points(self, where: Bool[np.ndarray, "rows columns"]) -> Points:
        """Points of the chosen readings in row-major order, camera frame, metres."""
        points = np.empty((np.count_nonzero(where), 3), np.float32)
        _gather(self.z_m, self.ray_x, self.ray_y, where, points)
        return points

    def distances_px(
        self, where: Bool[np.ndarray, "rows columns"], row: float, column: float
    ) -> Float32[np.ndarray, " n"]:
        """Distance of the chosen readings, in row-major order, from a place in the whole image, pixels."""
        distances_px = np.empty(np.count_nonzero(where), np.float32)
        first_row, first_column = self.first_pixel
        to_row, to_column = (row - first_row) / self.stride, (column - first_column) / self.stride
        _measure(where, to_row, to_column, float(self.stride), distances_px)
        return distances_px

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
    rows, columns = _pixels(depth_m.shape, window, stride)
    if window == WHOLE_IMAGE:
        z_m = np.ascontiguousarray(depth_m[rows, columns])
        ray_x, ray_y = _thinned_rays(intrinsics, stride)
    else:
        shape = len(range(*rows.indices(rows.stop))), len(range(*columns.indices(columns.stop)))
        z_m, ray_x, ray_y = np.empty(shape, np.float32), np.empty(shape, np.float32), np.empty(shape, np.float32)
        upright = intrinsics.distortion is None
        _cut(depth_m, *ray_grid(intrinsics), upright, rows.start, columns.start, stride, z_m, ray_x, ray_y)
    return DepthView(z_m, ray_x, ray_y, (rows.start, columns.start), stride)


def view_rays(intrinsics: Intrinsics, window: Window, stride: int) -> tuple[Rays, Rays]:
    """x/z and y/z of the rays of a view's pixels."""
    if window == WHOLE_IMAGE:
        return _thinned_rays(intrinsics, stride)
    pixels = _pixels((intrinsics.height, intrinsics.width), window, stride)
    whole_x, whole_y = ray_grid(intrinsics)
    if intrinsics.distortion is not None:
        return whole_x[pixels].copy(), whole_y[pixels].copy()
    # All rows have one row's x/z and all columns one column's y/z: nothing more is fetched from memory.
    across, down = whole_x[:1, pixels[1]], whole_y[pixels[0], :1]
    ray_x, ray_y = (np.empty((down.shape[0], across.shape[1]), np.float32) for _ in range(2))
    ray_x[:], ray_y[:] = across, down
    return ray_x, ray_y


def _pixels(shape: tuple[int, ...], window: Window, stride: int) -> Window:
    """Every `stride`-th row and column of a window, as slices of the whole image."""
    (top, bottom, _), (left, right, _) = (side.indices(size) for side, size in zip(window, shape, strict=True))
    return slice(top, bottom, stride), slice(left, right, stride)


@lru_cache(maxsize=8)
def _thinned_rays(intrinsics: Intrinsics, stride: int) -> tuple[Rays, Rays]:
    """Rays of every `stride`-th pixel, gathered once for a camera: strided reads cost more than the arithmetic."""
    # Copies that could be written, as all other rays of a view: kernels are compiled once more for read-only arrays.
    ray_x, ray_y = (image[::stride, ::stride].copy() for image in ray_grid(intrinsics))
    return ray_x, ray_y


@compiled
def _cut(
    depth_m: DepthImage,
    whole_x: Float32[np.ndarray, "height width"],
    whole_y: Float32[np.ndarray, "height width"],
    upright: bool,
    top: int,
    left: int,
    stride: int,
    z_m: Float32[np.ndarray, "rows columns"],
    ray_x: Rays,
    ray_y: Rays,
) -> None:
    """Readings and rays of a view; of `upright` rays only the first row's x/z and the first column's y/z are read."""
    for row in range(z_m.shape[0]):
        at = top + stride * row
        line, across = depth_m[at], whole_x[0 if upright else at]
        for column in range(z_m.shape[1]):
            z_m[row, column] = line[np.uintp(left + stride * column)]
        for column in range(z_m.shape[1]):
            ray_x[row, column] = across[np.uintp(left + stride * column)]
        if upright:
            ray_y[row] = whole_y[at, 0]
        else:
            for column in range(z_m.shape[1]):
                ray_y[row, column] = whole_y[at, np.uintp(left + stride * column)]


@compiled
def _measure(
    where: Bool[np.ndarray, "rows columns"],
    to_row: float,
    to_column: float,
    stride: float,
    distances_px: Float32[np.ndarray, " n"],
) -> None:
    n = 0
    for row in range(where.shape[0]):
        for column in range(where.shape[1]):
            if where[row, column]:
                distances_px[n] = stride * math.sqrt((row - to_row) ** 2 + (column - to_column) ** 2)
                n += 1


@compiled
def _gather(
    z_m: Float32[np.ndarray, "rows columns"],
    ray_x: Float32[np.ndarray, "rows columns"],
    ray_y: Float32[np.ndarray, "rows columns"],
    where: Bool[np.ndarray, "rows columns"],
    points: Points,
) -> None:
    n = 0
    for row in range(z_m.shape[0]):
        for column in range(z_m.shape[1]):
            if where[row, column]:
                z = z_m[row, column]
                points[n, 0] = ray_x[row, column] * z
                points[n, 1] = ray_y[row, column] * z
                points[n, 2] = z
                n += 1


def on_surface(z_m: Float32[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    """Readings that lie on a surface, and do not hang in the air between two as sensors report at edges.

    A reading on a surface has a neighbour at its own depth, and is not on a ramp that jumps before it and after it.
    """
    surface = np.empty(z_m.shape, np.bool_)
    _find_surface(z_m, surface)
    return surface


@compiled
def _find_surface(z_m: Float32[np.ndarray, "rows columns"], surface: Bool[np.ndarray, "rows columns"]) -> None:
    rows, columns = z_m.shape
    hole = np.float32(np.nan)
    for row in range(rows):
        for column in range(columns):
            z = z_m[row, column]
            left = z_m[row, column - 1] if column > 0 else hole
            right = z_m[row, column + 1] if column + 1 < columns else hole
            above = z_m[row - 1, column] if row > 0 else hole
            below = z_m[row + 1, column] if row + 1 < rows else hole
            surface[row, column] = is_on_surface(left, z, right, above, below)


@compiled
def is_on_surface(left: np.float32, z: np.float32, right: np.float32, above: np.float32, below: np.float32) -> bool:
    """See `on_surface`: of one reading and its four neighbours, NaN where there is none."""
    across, along_x = _neighbourhood(left, z, right)
    down, along_y = _neighbourhood(above, z, below)
    return (across or down) and not (along_x or along_y)


@compiled
def _neighbourhood(before: np.float32, z: np.float32, after: np.float32) -> tuple[bool, bool]:
    """Whether one of two opposite neighbours is level with a reading, and whether it is on a ramp between them.

    Comparisons with NaN are false: a hole is neither a level neighbour nor a jump.
    """
    step_in, step_out = z - before, after - z
    jump_in = max(np.float32(JUMP_M), np.float32(JUMP_PER_DEPTH) * z)
    jump_out = max(np.float32(JUMP_M), np.float32(JUMP_PER_DEPTH) * after)
    level = (abs(step_in) <= jump_in) | (abs(step_out) <= jump_out)
    rises = (step_in > jump_in) & (step_out > jump_out)
    falls = (step_in < -jump_in) & (step_out < -jump_out)
    return bool(level), bool(rises | falls)


def narrowed(where: Bool[np.ndarray, "rows columns"], kept: Bool[np.ndarray, " n"]) -> Bool[np.ndarray, "rows columns"]:
    """Of the n set pixels of an image, in row-major order, those that are kept."""
    fewer = np.zeros(where.shape, np.bool_)
    _narrow(where, kept, fewer)
    return fewer


@compiled
def _narrow(
    where: Bool[np.ndarray, "rows columns"], kept: Bool[np.ndarray, " n"], fewer: Bool[np.ndarray, "rows columns"]
) -> None:
    n = 0
    for row in range(where.shape[0]):
        for column in range(where.shape[1]):
            if where[row, column]:
                fewer[row, column] = kept[n]
                n += 1


@compiled
def box_of(image: Int32[np.ndarray, "rows columns"] | Bool[np.ndarray, "rows columns"], value: int) -> Box:
    """The box of the pixels that have a value, for loops that are compiled; as `window_around`, empty without any."""
    rows, columns = image.shape
    none, beyond = np.int32(-1), np.int32(columns)
    first_row, last_row, first_column, last_column = rows, -1, beyond, none
    for row in range(rows):
        first, last = beyond, none
        for column in range(columns):  # eight at once
            found = image[row, column] == value
            first = min(first, np.int32(column) if found else beyond)
            last = max(last, np.int32(column) if found else none)
        if last >= 0:
            first_row, last_row = min(first_row, row), row
            first_column, last_column = min(first_column, first), max(last_column, last)
    return first_row, last_row + 1, int(first_column), int(last_column) + 1


def window_around(shown: Bool[np.ndarray, "rows columns"], margin: float = 0.0, margin_px: int = 0) -> Window:
    """Box around the set pixels of an image (at least one), wider on each side by a share of itself and some pixels."""
    column, row, columns, rows = cv2.boundingRect(shown.view(np.uint8))
    sides = []
    for first, count, size in zip((row, column), (rows, columns), shown.shape, strict=True):
        more = max(margin_px, round(margin * count))
        sides.append(slice(max(first - more, 0), min(first + count + more, size)))
    return sides[0], sides[1]
