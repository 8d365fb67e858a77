"""Objects on a plane told apart by their footprints: what touches when seen from above is one object.

Neither holes in the depth image nor the jump from the rim of a cup to its inside split an object this way, and two
objects that overlap in the image but stand apart stay two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, UInt8

from service.core.arrays import Points, Vector3
from service.core.compiled import compiled
from service.core.depth_view import Box, DepthView, Rays, Window, box_of
from service.core.grids import crossed
from service.core.regions import grown, regions

Vector2: TypeAlias = Float64[np.ndarray, " axes=2"]

CELL_M = 0.004
"""Edge of a cell of the map, metres."""

CELL_PER_DEPTH = 0.006
"""The same per metre of depth, where that is more: noise and pixel spacing grow with it."""

VESSEL_GAP_CELLS = 8
"""Gaps up to this wide may break a ring of footprints that counts as one vessel."""

REACH_CELLS = 256
"""The map reaches this far to each side of the object's place, so a metre and more."""


@dataclass(frozen=True)
class Footprints:
    """A map of footprints seen from above.

    Attributes:
        axes: Horizontal axes of the map in the camera frame, one a row.
        corner_m: Place of the map's first cell along them.
        cell_m: Edge of a cell.
        labels: Number of the footprint in each cell, 0 where there is none.
    """

    axes: Float32[np.ndarray, "axes=2 3"]
    corner_m: Float32[np.ndarray, " axes=2"]
    cell_m: float
    labels: Int32[np.ndarray, "rows columns"]

    def label_of(self, points: Points) -> Int32[np.ndarray, " n"]:
        """Number of the footprint that each point (camera frame, metres) stands in; 0 for none."""
        found = np.empty(len(points), np.int32)
        _look_up(points, self.axes, self.corner_m, np.float32(1.0 / self.cell_m), self.labels, found)
        return found


@dataclass(frozen=True)
class NearestFootprint:
    """Attributes:
    footprints: The map it is on.
    label: Its number there.
    extent_m: Longer side of the box around it.
    box: The box, in the view, of the readings that stand in it.
    """

    footprints: Footprints
    label: int
    extent_m: float
    box: Window


def find_footprints(points: Points, up: Vector3, place_m: Vector3) -> Footprints | None:
    """Map the footprints of points.

    Gaps of up to two cells (8 mm, 1.2 % of the depth where that is more) are closed. Footprints that enclose a hole
    together, with gaps of up to eight cells between them, are one: the near and the far wall of a vessel, whose rim the
    sensor does not resolve. The hole then belongs to them.

    Args:
        points: Points above the support, camera frame, metres.
        up: Unit vector against gravity.
        place_m: Where the object is about; the map is laid around it.

    Returns:
        The map, or None where no point lies within its reach.
    """
    axes, cell_m, place = _laid_out(up, place_m)
    labels, corner_m = _map(points, axes, place, cell_m)
    return Footprints(axes, corner_m, cell_m, labels) if labels.size else None


def nearest_footprint(
    view: DepthView,
    core: Bool[np.ndarray, "rows columns"],
    up: Vector3,
    place_m: Vector3,
    nearest_to: Vector3 | tuple[float, float],
    min_points: int,
) -> NearestFootprint | None:
    """The footprint that the nearest reading stands in, of those that enough readings stand in; None without any.

    Args:
        view: A part of the depth image.
        core: The readings that footprints are mapped of, see `find_footprints`.
        up: Unit vector against gravity.
        place_m: Where the object is about.
        nearest_to: A point in the camera frame, metres, or a pixel (row, column) of the whole image.
        min_points: Readings that are enough.
    """
    axes, cell_m, place = _laid_out(up, place_m)
    if isinstance(nearest_to, tuple):
        row, column = ((to - first) / view.stride for to, first in zip(nearest_to, view.first_pixel, strict=True))
        goal, by_pixel = np.array([row, column, 0.0], np.float32), True
    else:
        goal, by_pixel = nearest_to.astype(np.float32), False
    labels, corner_m, label, extent, box = _nearest(
        view.z_m, view.ray_x, view.ray_y, core, axes, place, cell_m, goal, by_pixel, min_points
    )
    if label == 0:
        return None
    window = slice(*box[:2]), slice(*box[2:])
    return NearestFootprint(Footprints(axes, corner_m, cell_m, labels), label, cell_m * extent, window)


def _laid_out(up: Vector3, place_m: Vector3) -> tuple[Float32[np.ndarray, "axes=2 3"], float, Vector2]:
    """Axes of a map, the edge of its cells, and the object's place along the axes."""
    axes = _horizontal_axes(up)
    return axes, max(CELL_M, CELL_PER_DEPTH * abs(float(place_m[2]))), axes.astype(np.float64) @ place_m


@compiled
def _nearest(
    z_m: Rays, ray_x: Rays, ray_y: Rays, core: Bool[np.ndarray, "rows columns"], axes: Float32[np.ndarray, "axes=2 3"],
    place: Vector2, cell_m: float, goal: Float32[np.ndarray, "3"], by_pixel: bool, min_points: int,
) -> tuple[Int32[np.ndarray, "down across"], Float32[np.ndarray, " 2"], int, int, Box]:  # fmt: skip
    """The map and its corner, see `_map`; number of the nearest footprint, its longer side in cells; the box of the
    readings in it.
    """
    count = 0
    for row in range(core.shape[0]):
        for column in range(core.shape[1]):
            count += core[row, column]
    points, distance, n = np.empty((count, 3), np.float32), np.empty(count, np.float32), 0
    for row in range(core.shape[0]):
        for column in range(core.shape[1]):
            if core[row, column]:
                z = z_m[row, column]
                x, y = ray_x[row, column] * z, ray_y[row, column] * z
                points[n, 0], points[n, 1], points[n, 2] = x, y, z
                if by_pixel:
                    x, y, z = np.float32(row), np.float32(column), np.float32(0.0)
                distance[n] = (x - goal[0]) ** 2 + (y - goal[1]) ** 2 + (z - goal[2]) ** 2
                n += 1
    labels, corner_m = _map(points, axes, place, cell_m)
    found = np.empty(count, np.int32)
    if labels.size > 0:
        _look_up(points, axes, corner_m, np.float32(1.0 / cell_m), labels, found)
    label = _choose(found, distance, min_points) if labels.size > 0 else 0
    if label == 0:
        return labels, corner_m, 0, 0, (0, 0, 0, 0)
    standing, n = np.zeros(core.shape, np.int32), 0
    for row in range(core.shape[0]):
        for column in range(core.shape[1]):
            if core[row, column]:
                standing[row, column] = found[n]
                n += 1
    first_down, end_down, first_across, end_across = box_of(labels, label)
    extent = max(end_down - first_down, end_across - first_across)
    return labels, corner_m, label, extent, box_of(standing, label)


@compiled
def _join_vessels(
    occupied: UInt8[np.ndarray, "rows columns"], labels: Int32[np.ndarray, "rows columns"], count: int
) -> None:
    """Give the footprints around each enclosed hole, and the hole, one label; the labels are at most `count`."""
    reach = VESSEL_GAP_CELLS // 2
    holes, areas = regions(grown(occupied, reach), 0)
    first_row, last_row = np.full(areas + 1, holes.shape[0]), np.zeros(areas + 1, np.int64)
    for row in range(holes.shape[0]):
        for column in range(holes.shape[1]):
            first_row[holes[row, column]] = min(first_row[holes[row, column]], row)
            last_row[holes[row, column]] = row
    # The first is the outside, which holds the first cell of the map, whose margin is free.
    for hole in range(2, areas + 1):
        rows = slice(first_row[hole] - reach, last_row[hole] + reach + 1)
        around, inside = labels[rows], grown((holes[rows] == hole).astype(np.uint8), reach)
        shares = np.zeros(count + 1, np.int64)
        for row in range(inside.shape[0]):
            for column in range(inside.shape[1]):
                shares[around[row, column]] += inside[row, column]
        # A neighbour seen through a gap of the wall is no part of it.
        walls = shares > 0.1 * shares[1:].sum()
        walls[0] = False
        if walls.any():
            joined = np.argmax(walls)
            for row in range(labels.shape[0]):
                for column in range(labels.shape[1]):
                    if walls[labels[row, column]]:
                        labels[row, column] = joined
            for row in range(inside.shape[0]):
                for column in range(inside.shape[1]):
                    if inside[row, column]:
                        around[row, column] = joined


@compiled
def _map(
    points: Points,
    axes: Float32[np.ndarray, "axes=2 3"],
    place_m: Vector2,
    cell_m: float,
) -> tuple[Int32[np.ndarray, "rows columns"], Float32[np.ndarray, " axes=2"]]:
    """Numbers of the footprints, and where the map's first cell lies; no cells where no point does.

    The map is as large as what stands on it and a margin all around.
    """
    reach, margin = np.float32(REACH_CELLS), VESSEL_GAP_CELLS // 2 + 2
    place, cells_per_m = place_m.astype(np.float32), np.float32(1.0 / cell_m)
    cells = np.empty((2, len(points)), np.int32)
    none, beyond = np.int32(-1), np.int32(2 * REACH_CELLS)
    top, bottom, left, right = beyond, none, beyond, none
    for point in range(len(points)):
        x, y, z = points[point, 0], points[point, 1], points[point, 2]
        down = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z - place[0]) * cells_per_m
        across = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - place[1]) * cells_per_m
        held = (abs(down) < reach) & (abs(across) < reach)
        row, column = np.int32(down + reach), np.int32(across + reach)
        cells[0, point], cells[1, point] = row if held else none, column
        top, bottom = min(top, row if held else beyond), max(bottom, row if held else none)
        left, right = min(left, column if held else beyond), max(right, column if held else none)
    if bottom < 0:
        return np.zeros((0, 0), np.int32), place
    occupied = np.zeros((bottom + 1 - top + 2 * margin, right + 1 - left + 2 * margin), np.uint8)
    for point in range(len(points)):
        if cells[0, point] >= 0:
            occupied[cells[0, point] - top + margin, cells[1, point] - left + margin] = 1
    labels, count = regions(grown(occupied, 1), 1)
    _join_vessels(occupied, labels, count)
    corner_m = np.empty(2, np.float32)
    corner_m[0] = place_m[0] + cell_m * (top - REACH_CELLS - margin)
    corner_m[1] = place_m[1] + cell_m * (left - REACH_CELLS - margin)
    return labels, corner_m


@compiled
def _choose(labels: Int32[np.ndarray, " n"], distance: Float32[np.ndarray, " n"], min_points: int) -> int:
    """Label (above 0) that the nearest point has, among the labels with enough points; 0 for none."""
    highest = 0
    for point in range(len(labels)):
        highest = max(highest, labels[point])
    counts = np.zeros(highest + 1, np.int64)
    for point in range(len(labels)):
        counts[labels[point]] += 1
    chosen, least = 0, np.float32(np.inf)
    for point in range(len(labels)):
        if distance[point] < least and labels[point] > 0 and counts[labels[point]] >= min_points:
            chosen, least = labels[point], distance[point]
    return chosen


@compiled
def _look_up(
    points: Points,
    axes: Float32[np.ndarray, "axes=2 3"],
    corner_m: Float32[np.ndarray, " axes=2"],
    cells_per_m: np.float32,
    labels: Int32[np.ndarray, "rows columns"],
    found: Int32[np.ndarray, " n"],
) -> None:
    """The number of the footprint that each point stands in; 0 outside the map."""
    rows, columns = labels.shape
    for point in range(len(points)):
        x, y, z = points[point, 0], points[point, 1], points[point, 2]
        down = (axes[0, 0] * x + axes[0, 1] * y + axes[0, 2] * z - corner_m[0]) * cells_per_m
        across = (axes[1, 0] * x + axes[1, 1] * y + axes[1, 2] * z - corner_m[1]) * cells_per_m
        inside = down >= np.float32(0.0) and down < rows and across >= np.float32(0.0) and across < columns
        found[point] = labels[int(down), int(across)] if inside else 0


def _horizontal_axes(up: Vector3) -> Float32[np.ndarray, "axes=2 3"]:
    """Two unit vectors across `up`; any will do."""
    # The cross product of `up` and the axis it has least of, and of `up` and that.
    x, y, z = up.tolist()
    least = min(abs(x), abs(y), abs(z))
    if abs(x) == least:
        a, b, c = 0.0, z, -y
    elif abs(y) == least:
        a, b, c = -z, 0.0, x
    else:
        a, b, c = y, -x, 0.0
    length = math.sqrt(a * a + b * b + c * c)
    first = a / length, b / length, c / length
    return np.array([first, crossed((x, y, z), first)], np.float32)
