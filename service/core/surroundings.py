"""The support plane around an object in a depth image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32

from service.core.arrays import DepthImage, Mask, Points, Vector3
from service.core.camera import Intrinsics
from service.core.compiled import compiled
from service.core.depth_view import WHOLE_IMAGE, DepthView, Rays, Window, view_depth, view_rays, window_around
from service.core.plane_fit import plane_tolerance_m
from service.core.support_plane import SupportPlane, find_support_plane, level_plane

PLANE_SAMPLES = 3000
"""Pixels that the support plane is fitted to."""

LOCALITY = 0.4
"""Distance from the object, in units of its depth, at which a point of the surroundings counts a quarter."""


@dataclass(frozen=True)
class Support:
    """The plane as fitted, which tells object from table, and as answered, which has the given `up` as its normal."""

    fitted: SupportPlane
    answered: SupportPlane

    def clearance(self, view: DepthView) -> Float32[np.ndarray, "rows columns"]:
        """Heights above the plane in units of its tolerance; NaN where there is no reading."""
        clearance = np.empty_like(view.z_m)
        normal, offset_m = self.fitted.normal.astype(np.float32), np.float32(self.fitted.offset_m)
        _clear(view.z_m, view.ray_x, view.ray_y, normal, offset_m, clearance)
        return clearance

    def window_above(self, depth_m: DepthImage, intrinsics: Intrinsics, window: Window, stride: int) -> Window | None:
        """Where readings rise above the plane by more than its tolerance, for a view of what rises.

        Args:
            depth_m: Metres, NaN where there is no reading.
            intrinsics: The camera.
            window: What is looked at.
            stride: Every how many rows and columns of it are.

        Returns:
            The box around what rises and, inside the window, one more of those rows and columns on each side, which
            tell what hangs in the air there; None where nothing rises.
        """
        sides = [side.indices(size) for side, size in zip(window, depth_m.shape, strict=True)]
        corner = sides[0][0], sides[1][0]
        normal, offset_m = self.fitted.normal.astype(np.float32), np.float32(self.fitted.offset_m)
        rays, upright = view_rays(intrinsics, window, stride), intrinsics.distortion is None
        box = _find_above(depth_m, *rays, upright, *corner, stride, normal, offset_m)
        if box[1] < 0:
            return None
        rows, columns = (
            slice(max(start + stride * (first - 1), start), min(start + stride * (last + 1) + 1, stop))
            for (start, stop, _), first, last in zip(sides, box[::2], box[1::2], strict=True)
        )
        return rows, columns


@compiled
def _find_above(
    depth_m: DepthImage,
    ray_x: Rays,
    ray_y: Rays,
    upright: bool,
    top: int,
    left: int,
    stride: int,
    normal: Float32[np.ndarray, "3"],
    offset_m: np.float32,
) -> tuple[int, int, int, int]:
    """First and last row, first and last column of the rays whose readings rise above a plane; -1 last for none.

    Where rows and columns of rays are `upright`, the first row's x/z and the first column's y/z are all that is read.
    """
    nx, ny, nz = normal
    rows, columns = ray_x.shape
    z_m, down = np.empty(columns, np.float32), np.empty(columns, np.float32)
    first_row, last_row, first_column, last_column = rows, -1, np.int32(columns), np.int32(-1)
    for row in range(rows):
        line, across = depth_m[top + stride * row], ray_x[0 if upright else row]
        if upright:
            down[:] = ray_y[row, 0]
        else:
            down[:] = ray_y[row]
        for column in range(columns):
            z_m[column] = line[np.uintp(left + stride * column)]
        first, last = np.int32(columns), np.int32(-1)
        for column in range(columns):
            z = z_m[column]
            height_m = (nx * across[column] + ny * down[column] + nz) * z + offset_m
            rises = height_m > plane_tolerance_m(z)
            first = min(first, np.int32(column) if rises else np.int32(columns))
            last = max(last, np.int32(column) if rises else np.int32(-1))
        if last >= 0:
            first_row, last_row = min(first_row, row), row
            first_column, last_column = min(first_column, first), max(last_column, last)
    return first_row, last_row, int(first_column), int(last_column)


def distances_m(points: Points, place_m: Vector3) -> Float32[np.ndarray, " n"]:
    """Distance of each point from a place, metres."""
    distances_m = np.empty(len(points), np.float32)
    _measure(points, place_m.astype(np.float32), distances_m)
    return distances_m


@compiled
def _measure(points: Points, place_m: Float32[np.ndarray, "3"], distances_m: Float32[np.ndarray, " n"]) -> None:
    for point in range(len(points)):
        x, y, z = points[point, 0] - place_m[0], points[point, 1] - place_m[1], points[point, 2] - place_m[2]
        distances_m[point] = math.sqrt(x * x + y * y + z * z)


@compiled
def _weigh(
    points: Points, place_m: Float32[np.ndarray, "3"], reach_m: np.float32, weights: Float32[np.ndarray, " n"]
) -> None:
    """How near each point is to a place: 1 there, a quarter at the reach."""
    one = np.float32(1.0)
    _measure(points, place_m, weights)
    for point in range(len(points)):
        reaches = weights[point] / reach_m
        share = one + reaches * reaches
        weights[point] = one / (share * share)


@compiled
def _clear(
    z_m: Float32[np.ndarray, "rows columns"],
    ray_x: Float32[np.ndarray, "rows columns"],
    ray_y: Float32[np.ndarray, "rows columns"],
    normal: Float32[np.ndarray, "3"],
    offset_m: np.float32,
    clearance: Float32[np.ndarray, "rows columns"],
) -> None:
    nx, ny, nz = normal
    for row in range(z_m.shape[0]):
        for column in range(z_m.shape[1]):
            z = z_m[row, column]
            height_m = (nx * ray_x[row, column] + ny * ray_y[row, column] + nz) * z + offset_m
            clearance[row, column] = height_m / plane_tolerance_m(z)


def sample_view(depth_m: DepthImage, intrinsics: Intrinsics, window: Window) -> DepthView:
    """Thin a window out to about `PLANE_SAMPLES` pixels."""
    rows, columns = (len(range(*side.indices(size))) for side, size in zip(window, depth_m.shape, strict=True))
    return view_depth(depth_m, intrinsics, window, max(1, round((rows * columns / PLANE_SAMPLES) ** 0.5)))


def fit_support(
    points: Points, place_m: Vector3, known_object: Float32[np.ndarray, "known 3"], up: Vector3 | None
) -> Support | None:
    """Fit the support to points around a place, those nearer to it counting more; None where no plane is seen.

    Args:
        points: Points of the scene, camera frame, metres.
        place_m: Where the object is about.
        known_object: Points of the object, which must lie above the plane; may be empty.
        up: Unit vector against gravity, or None.
    """
    weights = np.empty(len(points), np.float32)
    _weigh(points, place_m.astype(np.float32), np.float32(LOCALITY * max(float(place_m[2]), 0.1)), weights)
    fitted = find_support_plane(points, weights, known_object, up)
    if fitted is None:
        return None
    return Support(fitted, fitted if up is None else level_plane(fitted, up, points, weights))


def support_around_mask(
    depth_m: DepthImage,
    intrinsics: Intrinsics,
    mask: Mask,
    object_points: Float32[np.ndarray, "known 3"],
    up: Vector3 | None,
) -> Support | None:
    """The plane in the surroundings of a mask; failing that, anywhere in the image."""
    # Masks are a little too tight as often as too wide: what lies right beside one is neither object nor table.
    near = window_around(mask, margin=0.75, margin_px=40)
    taken = np.zeros_like(mask)
    taken[near] = cv2.dilate(mask[near].view(np.uint8), np.ones((7, 7), np.uint8)).view(np.bool_)
    place_m = np.median(object_points, axis=0).astype(np.float64)
    for window in (near, WHOLE_IMAGE):
        view = sample_view(depth_m, intrinsics, window)
        points = view.points(np.isfinite(view.z_m) & ~view.crop(taken))
        support = fit_support(points, place_m, object_points, up)
        if support is not None:
            return support
    return None
