"""Which pixels are the object, and what it stands on.

A coarse pass over every few pixels finds the support plane and, seen from above, which footprint is the object's; a
fine pass takes the object's pixels at full resolution inside its window.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool

from service.core.arrays import DepthImage, Mask, Points, Vector3
from service.core.camera import Intrinsics, pixel_to_point, ray_grid
from service.core.depth_view import (
    WHOLE_IMAGE,
    DepthView,
    Window,
    narrowed,
    on_surface,
    view_depth,
    window_around,
)
from service.core.errors import EmptyObject, InvalidRequest, NoSupportPlane
from service.core.footprints import Footprints, nearest_footprint
from service.core.object_pixels import standing_in
from service.core.strays import without_background
from service.core.support_plane import SupportPlane
from service.core.surroundings import Support, distances_m, fit_support, sample_view, support_around_mask

MIN_OBJECT_POINTS = 30
"""Fewer points say nothing about a shape."""

COARSE_WIDTH = 320
"""Columns of the coarse pass; at 640 pixels every other row and column is read."""

CONTACT_REACH = 0.3
"""A contact farther than this from every reading, in units of their depth, is a mistake that chooses no object."""

BORDER_PX = 2
"""An object with a pixel this near to the image border is taken as cut by it."""

CORE_TOLERANCES = (2.0, 4.0, 8.0, 1.0)
"""Only points this many plane tolerances high link into one object, so that noise of the table links none; the next
level is tried where the object comes out too wide, so that low things do not link it to what is around it. The lowest
level comes last: it is for flat things, and links through the noise of the table."""

MAX_EXTENT_M = 0.5
"""An object wider than this is taken for several, if a higher level of linking takes it apart."""

MASK_TOLERANCES = 0.5
"""The same for points of a mask, which says itself what is object; the rest is the mask's bleeding onto the table."""

FACE_SHARE = 0.1
"""With nothing above a plane and this share of the readings below it, the plane is no support."""

IMAGE_UP = np.array([0.0, -1.0, 0.0])
"""Stands in for `up` where only parts of one mask are told apart."""


@dataclass(frozen=True)
class Segment:
    """An object in a depth image.

    Attributes:
        points: Points of its visible surface, camera frame, metres.
        box: The smallest window of the image that holds the pixels they come from.
        inside: Which pixels of that window these are, one for each point, in row-major order.
        image_shape: Rows and columns of the image.
        support: The plane it stands on; None where it is unknown and `up` is too.
        up: Unit vector against gravity, the support's normal; None where unknown.
        flags: `support_not_seen` (the support is put at the object's lowest point along the given `up`), `up_unknown`
            (no plane is seen and `up` was not given), `object_cut_by_border` (a part of it lies outside the image).
    """

    points: Points
    box: Window
    inside: Bool[np.ndarray, "rows columns"]
    image_shape: tuple[int, int]
    support: SupportPlane | None
    up: Vector3 | None
    flags: frozenset[str]

    @cached_property
    def pixels(self) -> Mask:
        """The pixels of the whole image that the points come from."""
        pixels = np.zeros(self.image_shape, np.bool_)
        pixels[self.box] = self.inside
        return pixels


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
        contact_m: Where the object is touched, camera frame. One that is far from everything seen is left out of
            account, so that the object is found and the caller can say how far off it the contact is.
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
    depth_m: DepthImage, intrinsics: Intrinsics, mask: Mask, window: Window, up: Vector3 | None
) -> Segment:
    masked = np.zeros_like(mask)
    masked[window] = mask[window]
    _require_points(masked, "The mask covers too few readings of the depth image.", "mask")
    view = view_depth(depth_m, intrinsics, window_around(masked))
    shown = view.crop(masked) & on_surface(view.z_m)
    _require_points(shown, "The mask covers too few readings of the depth image.", "mask")
    points = view.points(shown)
    few = points[:: max(1, len(points) // 300)]
    support = support_around_mask(depth_m, intrinsics, masked, few, up)
    if support is not None:
        clearance = support.clearance(view)
        _require_points(shown & (clearance > 1.0), "Too little of the mask rises above the support plane.", "mask")
        shown &= clearance > MASK_TOLERANCES
        points = view.points(shown)
    known_up = support.fitted.normal if support is not None else up
    kept = without_background(points, IMAGE_UP if known_up is None else known_up)
    shown = narrowed(shown, kept)
    return _finish(view.points(shown), shown, window_around(shown), view.first_pixel, intrinsics, support, up)


def _segment_cluster(
    depth_m: DepthImage, intrinsics: Intrinsics, window: Window, up: Vector3 | None, contact_m: Vector3 | None
) -> Segment:
    scene = sample_view(depth_m, intrinsics, WHOLE_IMAGE)
    readable = np.isfinite(scene.z_m)
    _require_points(readable, "The depth image has too few readings.", "depth")
    points = scene.points(readable)
    place_m = points[np.argmin(scene.distances_px(readable, *_middle(window, intrinsics)))].astype(np.float64)
    if contact_m is not None:
        reach_m = CONTACT_REACH * max(float(place_m[2]), 0.1)
        if distances_m(points, contact_m).min() > reach_m:
            contact_m = None
        else:
            place_m = contact_m
    support = fit_support(points, place_m, points[:0], up)
    found = None if support is None else _find_object(depth_m, intrinsics, window, support, None, place_m, contact_m)
    if support is not None and found is None:
        # Nothing above the plane but much below it: that plane is a face of the object.
        if np.mean(support.clearance(scene)[readable] < -2.0) < FACE_SHARE:
            raise EmptyObject(
                "No object stands above the support plane there; send a mask, or a contact on it.", field="depth"
            )
        support = None
    if support is None and up is None:
        raise NoSupportPlane(
            "No support plane is visible around the object; send `up`, or a mask of the object.",
            field="up",
            expected="`up`, `mask`, or a visible support plane",
        )
    if found is None:
        found = _find_object(depth_m, intrinsics, window, None, up, place_m, contact_m)
    if found is None:
        raise EmptyObject("No object is seen there; send a mask, or a contact on it.", field="depth")
    footprints, label, seen = found
    points, shown, around = standing_in(depth_m, intrinsics, seen, support, footprints, label)
    return _finish(points, shown, around, (seen[0].start, seen[1].start), intrinsics, support, up)


def _find_object(
    depth_m: DepthImage,
    intrinsics: Intrinsics,
    window: Window,
    support: Support | None,
    up: Vector3 | None,
    place_m: Vector3,
    contact_m: Vector3 | None,
) -> tuple[Footprints, int, Window] | None:
    """The map of footprints, the label of the object's and the window of the image that it is seen in.

    Without a support everything seen may be the object, and footprints are seen along `up`.
    """
    level = support.fitted.normal if support is not None else IMAGE_UP if up is None else up
    stride = max(1, round(intrinsics.width / COARSE_WIDTH))
    # The table is most of an image.
    standing = window if support is None else support.window_above(depth_m, intrinsics, window, stride)
    if standing is None:
        return None
    view = view_depth(depth_m, intrinsics, standing, stride)
    clearance = None if support is None else support.clearance(view)
    surface = on_surface(view.z_m)
    middle = _middle(window, intrinsics)
    found: tuple[Footprints, int, Window] | None = None
    for tolerances in CORE_TOLERANCES:
        core = surface if clearance is None else surface & (clearance > tolerances)
        nearest = nearest_footprint(
            view, core, level, place_m, middle if contact_m is None else contact_m,
            max(MIN_OBJECT_POINTS // stride**2, 3),
        )  # fmt: skip
        if nearest is None:
            continue
        wide = nearest.extent_m > MAX_EXTENT_M
        if found is None or not wide:
            seen = _enlarge(nearest.box, view, 2 * stride + 2, window, depth_m.shape)
            found = nearest.footprints, nearest.label, seen
        if not wide:
            break
    return found


def _finish(
    points: Points,
    shown: Bool[np.ndarray, "rows columns"],
    around: Window,
    first_pixel: tuple[int, int],
    intrinsics: Intrinsics,
    support: Support | None,
    up: Vector3 | None,
) -> Segment:
    """The object that points of a part of the image at full resolution show, in a box of that part."""
    _require_count(len(points), "Too few points are left of the object.", "depth")
    image_shape = intrinsics.height, intrinsics.width
    rows, columns = (
        slice(first + side.start, first + side.stop) for side, first in zip(around, first_pixel, strict=True)
    )
    flags = set()
    if min(rows.start, image_shape[0] - rows.stop, columns.start, image_shape[1] - columns.stop) < BORDER_PX:
        flags.add("object_cut_by_border")
    plane = None if support is None else support.answered
    if plane is None:
        flags.add("up_unknown" if up is None else "support_not_seen")
        # Half a percent of the points may be noise below the object.
        plane = None if up is None else SupportPlane(up, -float(np.percentile(points @ up.astype(np.float32), 0.5)))
    up = None if plane is None else plane.normal
    return Segment(points, (rows, columns), shown[around], image_shape, plane, up, frozenset(flags))


def _middle(window: Window, intrinsics: Intrinsics) -> tuple[float, float]:
    """Row and column of the middle of a window."""
    rows, columns = window[0].indices(intrinsics.height), window[1].indices(intrinsics.width)
    return (rows[0] + rows[1] - 1) / 2, (columns[0] + columns[1] - 1) / 2


def _enlarge(box: Window, view: DepthView, margin_px: int, within: Window, shape: tuple[int, ...]) -> Window:
    """A box of pixels of the view as a window of the whole image, widened by a margin inside another window."""
    sides = []
    for side, first, limit, size in zip(box, view.first_pixel, within, shape, strict=True):
        lowest, highest, _ = limit.indices(size)
        start = first + side.start * view.stride - margin_px
        stop = first + (side.stop - 1) * view.stride + 1 + margin_px
        sides.append(slice(max(start, lowest), min(stop, highest)))
    return sides[0], sides[1]


def _roi_window(roi: tuple[int, int, int, int] | None, intrinsics: Intrinsics) -> Window:
    if roi is None:
        return WHOLE_IMAGE
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


def _require_points(pixels: Bool[np.ndarray, "rows columns"], message: str, field: str) -> None:
    _require_count(int(np.count_nonzero(pixels)), message, field)


def _require_count(count: int, message: str, field: str) -> None:
    if count < MIN_OBJECT_POINTS:
        raise EmptyObject(message, field=field, expected=f"at least {MIN_OBJECT_POINTS} points", actual=count)
