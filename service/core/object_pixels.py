"""The pixels of an object whose footprint is known, at full resolution."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32, Int32

from service.core.arrays import DepthImage, Points
from service.core.camera import Intrinsics, ray_grid
from service.core.compiled import compiled
from service.core.depth_view import Box, Rays, Window, box_of, is_on_surface
from service.core.footprints import Footprints
from service.core.plane_fit import plane_tolerance_m
from service.core.surroundings import Support


def standing_in(
    depth_m: DepthImage,
    intrinsics: Intrinsics,
    window: Window,
    support: Support | None,
    footprints: Footprints,
    label: int,
) -> tuple[Points, Bool[np.ndarray, "rows columns"], Window]:
    """Which readings lie on a surface, rise above the support and stand in one footprint.

    Args:
        depth_m: Metres, NaN where there is no reading.
        intrinsics: The camera.
        window: What is looked at.
        support: None lets everything rise.
        footprints: The map.
        label: Number of the footprint.

    Returns:
        Their points in row-major order, camera frame, metres; the pixels of the window that these are, and the box in
        the window around them, empty where there are none.
    """
    (top, bottom, _), (left, right, _) = (side.indices(size) for side, size in zip(window, depth_m.shape, strict=True))
    shown = np.empty((bottom - top, right - left), np.bool_)
    normal, offset_m = np.zeros(3, np.float32), np.float32(np.inf)  # higher than any tolerance
    if support is not None:
        normal, offset_m = support.fitted.normal.astype(np.float32), np.float32(support.fitted.offset_m)
    points, box = _choose(
        depth_m, *ray_grid(intrinsics), intrinsics.distortion is None, top, left, normal, offset_m,
        footprints.axes, footprints.corner_m, np.float32(1.0 / footprints.cell_m), footprints.labels, label, shown,
    )  # fmt: skip
    return points, shown, (slice(*box[:2]), slice(*box[2:]))


@compiled
def _choose(
    depth_m: DepthImage, whole_x: Rays, whole_y: Rays, upright: bool, top: int, left: int,
    normal: Float32[np.ndarray, "3"], offset_m: np.float32,
    axes: Float32[np.ndarray, "axes=2 3"], corner_m: Float32[np.ndarray, " axes=2"], cells_per_m: np.float32,
    labels: Int32[np.ndarray, "down across"], label: int, shown: Bool[np.ndarray, "rows columns"],
) -> tuple[Points, Box]:  # fmt: skip
    """A row of pixels at a time: first the cell of each, eight at once, then what stands there.

    Of `upright` rays only the first row's x/z and the first column's y/z are read.
    """
    rows, columns = shown.shape
    nothing, high, wide = np.float32(0.0), np.float32(labels.shape[0]), np.float32(labels.shape[1])
    cells, cell, one = labels.ravel(), np.empty(columns, np.int32), np.float32(1.0)
    ray_x, ray_y = np.empty(columns, np.float32), np.empty(columns, np.float32)
    # the row before, this one and the one after, with a hole on each side
    around = np.full((3, columns + 2), np.float32(np.nan), np.float32)
    for column in range(columns if rows > 0 else 0):
        around[2, column + 1] = depth_m[top, np.uintp(left + column)]
        ray_x[column] = whole_x[0, np.uintp(left + column)]
    count = 0
    for row in range(rows):
        # the row after is written over the one two before; before the first lie holes
        above, here, below = around[(row + 1) % 3], around[(row + 2) % 3], around[row % 3]
        for column in range(columns):
            below[column + 1] = (
                depth_m[top + row + 1, np.uintp(left + column)] if row + 1 < rows else np.float32(np.nan)
            )
        ray_y[:] = whole_y[top + row, 0]
        if not upright:
            for column in range(columns):
                ray_x[column] = whole_x[top + row, np.uintp(left + column)]
                ray_y[column] = whole_y[top + row, np.uintp(left + column)]
        for column in range(columns):
            z = here[column + 1]
            surface = is_on_surface(here[column], z, here[column + 2], above[column + 1], below[column + 1])
            height_m = (normal[0] * ray_x[column] + normal[1] * ray_y[column] + normal[2]) * z + offset_m
            x, y = ray_x[column] * z, ray_y[column] * z
            down = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z - corner_m[0]) * cells_per_m
            across = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - corner_m[1]) * cells_per_m
            inside = (down >= nothing) & (down < high) & (across >= nothing) & (across < wide)
            inside &= surface & (height_m / plane_tolerance_m(z) > one)
            down, across = (down if inside else nothing), (across if inside else nothing)
            place = np.int32(down) * np.int32(labels.shape[1]) + np.int32(across)
            cell[column] = np.int32(place) if inside else np.int32(-1)
        for column in range(columns):
            stands = cell[column] >= 0 and cells[np.uint32(cell[column])] == label
            shown[row, column] = stands
            count += stands
    points, n = np.empty((count, 3), np.float32), 0
    for row in range(rows):
        for column in range(columns):
            if shown[row, column]:
                z = depth_m[top + row, left + column]
                points[n, 0] = whole_x[0 if upright else top + row, left + column] * z
                points[n, 1] = whole_y[top + row, 0 if upright else left + column] * z
                points[n, 2] = z
                n += 1
    return points, box_of(shown, True)
