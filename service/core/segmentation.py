"""Which pixels are the object, and what it stands on.

A coarse pass over every few pixels finds the support plane and, seen from above, which footprint is the object's; a
fine pass takes the object's pixels at full resolution inside its window.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Int64

from service.core.arrays import DepthImage, Mask, Points, Vector3
from service.core.camera import Intrinsics, pixel_to_point, ray_grid
from service.core.errors import EmptyObject, InvalidRequest, NoSupportPlane
from service.core.footprints import Footprints, find_footprints
from service.core.readings import Readings, is_flying, read_grid, window_around
from service.core.support_plane import SupportPlane, find_support_plane, level_plane, plane_tolerance_m

MIN_OBJECT_POINTS = 30
"""Fewer points say nothing about a shape."""

COARSE_WIDTH = 320
"""Columns of the coarse pass; at 640 pixels every other row and column is read."""

PLANE_SAMPLES = 2500
"""Points that the support plane is fitted to."""

LOCALITY = 0.4
"""Distance from the object, in units of its depth, at which a point of the surroundings counts a quarter."""

BORDER_PX = 2
"""An object with a pixel this near to the image border is taken as cut by it."""

CORE_TOLERANCES = 2.0
"""Only points this many plane tolerances high link into one object, so that noise of the table links none."""

MASK_TOLERANCES = 0.5
"""The same for points of a mask, which says itself what is object; the rest is the mask's bleeding onto the table."""

IMAGE_UP = np.array([0.0, -1.0, 0.0])
"""Stands in for `up` where only parts of one mask are told apart."""


@dataclass(frozen=True)
class Segment:
    """An object in a depth image.

    Attributes:
        points: Points of its visible surface, camera frame, metres.
        pixels: The pixels they come from, one for each point, in row-major order.
        support: The plane it stands on; None where it is unknown and `up` is too.
        up: Unit vector against gravity, the support's normal; None where unknown.
        flags: `support_not_seen` (the support is put at the object's lowest point along the given `up`), `up_unknown`
            (no plane is seen and `up` was not given), `object_cut_by_border` (a part of it lies outside the image).
    """

    points: Points
    pixels: Mask
    support: SupportPlane | None
    up: Vector3 | None
    flags: frozenset[str]


@dataclass(frozen=True)
class _Support:
    """The plane as fitted, which tells object from table, and as answered, which has the given `up` as its normal."""

    fitted: SupportPlane
    answered: SupportPlane

    def clearance(self, points: Points) -> Float32[np.ndarray, " n"]:
        """Heights above the plane in units of its tolerance."""
        return np.asarray(self.fitted.heights_m(points) / plane_tolerance_m(points[:, 2]), np.float32)


def segment(
    depth_m: DepthImage,
    intrinsics: Intrinsics,
    mask: Mask | None = None,
    up: Vector3 | None = None,
    contact_m: Vector3 | None = None,
    contact_px: tuple[float, float] | None = None,
    roi: tuple[int, int, int, int] | None = None,
) -> Segment:
    """Find the object and its support plane.

    With a mask the object is what the mask shows above the support. Without one it is the cluster above the support
    that is nearest to the contact, or to the middle of the image (of the region of interest) where none is named.

    Args:
        depth_m: Metres, NaN where there is no reading.
        intrinsics: The camera.
        mask: Pixels of the object; None to find them.
        up: Unit vector against gravity in the camera frame; None to take it from the support plane. Only planes
            within 15° of it count. Where plane and `up` agree to 1° the given one becomes the support's normal.
        contact_m: Where the object is touched, camera frame.
        contact_px: The same as a pixel (u, v), read from the depth image.
        roi: (u, v, width, height) that the object is searched in.

    Raises:
        NoSupportPlane: No plane is seen, and neither `up` nor a mask was given.
        EmptyObject: Fewer than 30 points are left of the object.
        InvalidRequest: The contact pixel or the region of interest is not usable.
    """
    if intrinsics.distortion is not None:
        depth_m = depth_m + np.float32(0.0) * ray_grid(intrinsics)[0]  # NaN where the lens model has no ray
    window = _roi_window(roi, intrinsics)
    if contact_px is not None and contact_m is None:
        contact_m = pixel_to_point(*contact_px, depth_m, intrinsics, mask=mask)
    if mask is not None:
        return _segment_masked(depth_m, intrinsics, mask, window, up)
    return _segment_cluster(depth_m, intrinsics, window, up, contact_m)


def _segment_masked(
    depth_m: DepthImage, intrinsics: Intrinsics, mask: Mask, window: tuple[slice, slice], up: Vector3 | None
) -> Segment:
    shown = read_grid(depth_m, intrinsics, window=window, among=mask)
    _require_points(shown, "The mask covers too few readings of the depth image.", "mask")
    shown = shown.keep(~is_flying(shown.pixels, depth_m))
    _require_points(shown, "The mask covers too few readings of the depth image.", "mask")
    support = _support_around(depth_m, intrinsics, mask, shown, up)
    if support is not None:
        shown = shown.keep(support.clearance(shown.points) > MASK_TOLERANCES)
        _require_points(shown, "Too little of the mask rises above the support plane.", "mask")
    known_up = support.fitted.normal if support is not None else up
    shown = _without_background(shown, IMAGE_UP if known_up is None else known_up)
    return _finish(shown, intrinsics, support, up)


def _segment_cluster(
    depth_m: DepthImage,
    intrinsics: Intrinsics,
    window: tuple[slice, slice],
    up: Vector3 | None,
    contact_m: Vector3 | None,
) -> Segment:
    stride = max(1, round(intrinsics.width / COARSE_WIDTH))
    scene = read_grid(depth_m, intrinsics, stride)
    coarse = scene if window == (slice(None), slice(None)) else read_grid(depth_m, intrinsics, stride, window)
    _require_points(coarse, "The depth image has too few readings.", "depth")
    middle_px = _pixel_distance(coarse.pixels, window, intrinsics)
    place_m = coarse.points[np.argmin(middle_px)].astype(np.float64) if contact_m is None else contact_m
    known_object = scene.points[:0] if contact_m is None else contact_m[None].astype(np.float32)
    support = _fit_support(scene.points, place_m, known_object, up)
    if support is None and up is None:
        raise NoSupportPlane(
            "No support plane is visible around the object; send `up`, or a mask of the object.",
            field="up",
            expected="`up`, `mask`, or a visible support plane",
        )

    level = up if support is None else support.fitted.normal
    assert level is not None  # else NoSupportPlane was raised
    footprints, label = None, 0
    for tolerances in (CORE_TOLERANCES, 1.0):
        core = _above(coarse, support, tolerances)
        core = core.keep(~is_flying(core.pixels, depth_m))
        footprints = find_footprints(core.points, level, place_m)
        if footprints is not None:
            distance = (
                _pixel_distance(core.pixels, window, intrinsics)
                if contact_m is None
                else np.linalg.norm(core.points - contact_m.astype(np.float32), axis=1)
            )
            label = _nearest_footprint(footprints, core.points, distance, MIN_OBJECT_POINTS // stride**2)
        if label:
            break
    if footprints is None or not label:
        raise EmptyObject(
            "No object stands above the support plane there; send a mask, or a contact on the object.", field="depth"
        )
    core = core.keep(footprints.label_of(core.points) == label)
    box = window_around(core.pixels, depth_m.shape, 2 * stride + 2)
    fine = _above(read_grid(depth_m, intrinsics, window=_intersect(box, window)), support, 1.0)
    fine = fine.keep(footprints.label_of(fine.points) == label)
    fine = fine.keep(~is_flying(fine.pixels, depth_m))
    _require_points(fine, "Too few points are left of the object.", "depth")
    return _finish(fine, intrinsics, support, up)


def _above(readings: Readings, support: _Support | None, tolerances: float) -> Readings:
    """Readings that high above the support; all of them where it is not seen."""
    return readings if support is None else readings.keep(support.clearance(readings.points) > tolerances)


def _nearest_footprint(
    footprints: Footprints, points: Points, distance: Float32[np.ndarray, " n"], min_points: int
) -> int:
    """Label of the footprint that holds the nearest point, among those with enough points; 0 for none."""
    labels = footprints.label_of(points)
    large = np.bincount(labels) >= max(min_points, 3)
    large[0] = False
    eligible = large[labels]
    if not eligible.any():
        return 0
    return int(labels[np.argmin(np.where(eligible, distance, np.inf))])


def _support_around(
    depth_m: DepthImage, intrinsics: Intrinsics, mask: Mask, shown: Readings, up: Vector3 | None
) -> _Support | None:
    """The plane in the surroundings of a mask; failing that, anywhere in the image."""
    box = window_around(shown.pixels, depth_m.shape, 0)
    # Masks are a little too tight as often as too wide: what lies right beside one is neither object nor table.
    outside = cv2.dilate(mask.astype(np.uint8), np.ones((7, 7), np.uint8)) == 0
    place_m = np.median(shown.points, axis=0).astype(np.float64)
    object_points = shown.points[:: max(1, len(shown) // 200)]
    margin_px = tuple(max(40, round(0.75 * (side.stop - side.start))) for side in box)
    near = window_around(shown.pixels, depth_m.shape, (margin_px[0], margin_px[1]))
    for place in (near, (slice(None), slice(None))):
        rows, columns = (len(range(*side.indices(size))) for side, size in zip(place, depth_m.shape, strict=True))
        stride = max(1, round((rows * columns / (2 * PLANE_SAMPLES)) ** 0.5))
        surroundings = read_grid(depth_m, intrinsics, stride, place, among=outside)
        support = _fit_support(surroundings.points, place_m, object_points, up)
        if support is not None:
            return support
    return None


def _fit_support(points: Points, place_m: Vector3, known_object: Points, up: Vector3 | None) -> _Support | None:
    points = points[:: max(1, len(points) // PLANE_SAMPLES)]
    distance = np.linalg.norm(points - place_m.astype(np.float32), axis=1)
    weights = 1.0 / np.square(1.0 + np.square(distance / np.float32(LOCALITY * max(float(place_m[2]), 0.1))))
    fitted = find_support_plane(points, weights.astype(np.float32), known_object, up)
    if fitted is None:
        return None
    return _Support(fitted, fitted if up is None else level_plane(fitted, up, points, weights.astype(np.float32)))


def _without_background(shown: Readings, up: Vector3) -> Readings:
    """Drop what the mask shows far from its largest part: background beyond the object's edge."""
    footprints = find_footprints(shown.points, up, np.median(shown.points, axis=0).astype(np.float64))
    if footprints is None:
        return shown
    labels = footprints.label_of(shown.points)
    main = labels == np.argmax(np.bincount(labels, minlength=2)[1:]) + 1
    low, high = shown.points[main].min(axis=0), shown.points[main].max(axis=0)
    # The far side of a deep cup is seen apart from its near side, at most one diameter behind it.
    reach_m = np.linalg.norm(high - low)
    gap_m = np.linalg.norm(np.maximum(np.maximum(low - shown.points, shown.points - high), 0.0), axis=1)
    return shown.keep(main | (gap_m < reach_m))


def _finish(readings: Readings, intrinsics: Intrinsics, support: _Support | None, up: Vector3 | None) -> Segment:
    pixels = np.zeros((intrinsics.height, intrinsics.width), np.bool_)
    pixels.ravel()[readings.pixels] = True
    flags = set()
    row, column = np.divmod(readings.pixels, intrinsics.width)
    if (
        min(row[0], column.min()) < BORDER_PX
        or row[-1] >= intrinsics.height - BORDER_PX
        or column.max() >= intrinsics.width - BORDER_PX
    ):
        flags.add("object_cut_by_border")
    plane = None if support is None else support.answered
    if plane is None:
        flags.add("up_unknown" if up is None else "support_not_seen")
        plane = None if up is None else _lowest_plane(readings.points, up)
    return Segment(readings.points, pixels, plane, None if plane is None else plane.normal, frozenset(flags))


def _lowest_plane(points: Points, up: Vector3) -> SupportPlane:
    # Half a percent of the points may be noise below the object.
    return SupportPlane(up, -float(np.percentile(points @ up.astype(np.float32), 0.5)))


def _pixel_distance(
    pixels: Int64[np.ndarray, " n"], window: tuple[slice, slice], intrinsics: Intrinsics
) -> Float32[np.ndarray, " n"]:
    """Distance of pixels from the middle of the window."""
    rows, columns, _ = window[0].indices(intrinsics.height), window[1].indices(intrinsics.width), None
    row, column = np.divmod(pixels, intrinsics.width)
    return np.hypot(row - (rows[0] + rows[1] - 1) / 2, column - (columns[0] + columns[1] - 1) / 2).astype(np.float32)


def _roi_window(roi: tuple[int, int, int, int] | None, intrinsics: Intrinsics) -> tuple[slice, slice]:
    if roi is None:
        return slice(None), slice(None)
    u, v, width, height = roi
    columns = slice(max(u, 0), min(u + width, intrinsics.width))
    rows = slice(max(v, 0), min(v + height, intrinsics.height))
    if columns.stop <= columns.start or rows.stop <= rows.start:
        raise InvalidRequest(
            "The region of interest holds no pixel of the image.",
            field="roi",
            expected=f"(u, v, width, height) inside {intrinsics.width}x{intrinsics.height}",
            actual=str(tuple(roi)),
        )
    return rows, columns


def _intersect(a: tuple[slice, slice], b: tuple[slice, slice]) -> tuple[slice, slice]:
    rows, columns = (
        slice(max(p.start or 0, q.start or 0), p.stop if q.stop is None else min(p.stop, q.stop))
        for p, q in zip(a, b, strict=True)
    )
    return rows, columns


def _require_points(readings: Readings, message: str, field: str) -> None:
    if len(readings) < MIN_OBJECT_POINTS:
        raise EmptyObject(message, field=field, expected=f"at least {MIN_OBJECT_POINTS} points", actual=len(readings))
