"""Readings of a depth image: pixels and their points, kept side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int64

from service.core.arrays import DepthImage, Mask, Points
from service.core.camera import Intrinsics, back_project_pixels

JUMP_M = 0.008
"""A step in depth from one pixel to the next that no surface seen at a usable angle makes, metres."""

JUMP_PER_DEPTH = 0.015
"""The same per metre of depth, where that is more: pixels lie farther apart out there."""


@dataclass(frozen=True)
class Readings:
    """Some readings of one depth image.

    Attributes:
        pixels: Flat (row-major) index of each.
        points: Its point, camera frame, metres.
    """

    pixels: Int64[np.ndarray, " n"]
    points: Points

    def __len__(self) -> int:
        return len(self.pixels)

    def keep(self, which: Bool[np.ndarray, " n"]) -> Readings:
        return Readings(self.pixels[which], self.points[which])


def read_grid(
    depth_m: DepthImage,
    intrinsics: Intrinsics,
    stride: int = 1,
    window: tuple[slice, slice] = (slice(None), slice(None)),
    among: Mask | None = None,
) -> Readings:
    """Read every `stride`-th row and column of a window (rows, columns), among the pixels of a mask if one is given."""
    height, width = depth_m.shape
    first_row, last_row, _ = window[0].indices(height)
    first_column, last_column, _ = window[1].indices(width)
    grid = (slice(first_row, last_row, stride), slice(first_column, last_column, stride))
    readable = np.isfinite(depth_m[grid])
    if among is not None:
        readable &= among[grid]
    row, column = np.divmod(np.flatnonzero(readable), readable.shape[1])
    pixels = (row * stride + first_row) * width + (column * stride + first_column)
    return Readings(pixels, back_project_pixels(pixels, depth_m, intrinsics))


def is_flying(pixels: Int64[np.ndarray, " n"], depth_m: DepthImage) -> Bool[np.ndarray, " n"]:
    """Whether readings hang in the air between two surfaces, as sensors report at edges.

    Such a pixel either has no neighbour at its own depth, or lies on a ramp that jumps before it and after it.
    """
    height, width = depth_m.shape
    flat = depth_m.ravel()
    z_m = flat[pixels]
    jump_m = np.maximum(np.float32(JUMP_M), np.float32(JUMP_PER_DEPTH) * z_m)
    row, column = np.divmod(pixels, width)
    alone = np.ones(len(pixels), np.bool_)
    on_ramp = np.zeros(len(pixels), np.bool_)
    with np.errstate(invalid="ignore"):
        for place, size, step in ((column, width, 1), (row, height, width)):
            before = z_m - flat[np.where(place > 0, pixels - step, pixels)]
            after = flat[np.where(place < size - 1, pixels + step, pixels)] - z_m
            level = (np.abs(before) <= jump_m) & (place > 0) | (np.abs(after) <= jump_m) & (place < size - 1)
            alone &= ~level
            on_ramp |= ((before > jump_m) & (after > jump_m)) | ((before < -jump_m) & (after < -jump_m))
    return alone | on_ramp


def window_around(
    pixels: Int64[np.ndarray, " n"], shape: tuple[int, int], margin_px: int | tuple[int, int]
) -> tuple[slice, slice]:
    """Rows and columns of the box around pixels, widened by a margin (rows, columns) and cut at the image border."""
    row, column = np.divmod(pixels, shape[1])
    rows_px, columns_px = (margin_px, margin_px) if isinstance(margin_px, int) else margin_px
    return (
        slice(max(int(row.min()) - rows_px, 0), int(row.max()) + rows_px + 1),
        slice(max(int(column.min()) - columns_px, 0), int(column.max()) + columns_px + 1),
    )
