"""Objects on a plane told apart by their footprints: what touches when seen from above is one object.

Neither holes in the depth image nor the jump from the rim of a cup to its inside split an object this way, and two
objects that overlap in the image but stand apart stay two.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Int32, UInt8

from service.core.arrays import Points, Vector3

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
        rows, columns = self.labels.shape
        cells = (self.axes @ points.T - self.corner_m[:, None]) * np.float32(1.0 / self.cell_m)
        # The outermost cells are empty, so whatever lies outside the map may be read there.
        row = np.clip(cells[0], 0, rows - 1).astype(np.int32)
        column = np.clip(cells[1], 0, columns - 1).astype(np.int32)
        return np.asarray(self.labels.ravel()[row * columns + column], np.int32)

    def extent_m(self, label: int) -> float:
        """Longer side of the box around one footprint, metres."""
        shown = self.labels == label
        return self.cell_m * max(int(np.ptp(np.flatnonzero(shown.any(axis=axis)))) + 1 for axis in (0, 1))


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
    axes = _horizontal_axes(up)
    cell_m = max(CELL_M, CELL_PER_DEPTH * abs(float(place_m[2])))
    cells = (axes @ points.T - (axes.astype(np.float64) @ place_m).astype(np.float32)[:, None]) * np.float32(
        1.0 / cell_m
    )
    near = (np.abs(cells[0]) < REACH_CELLS) & (np.abs(cells[1]) < REACH_CELLS)
    row, column = np.floor(cells[0][near]).astype(np.int32), np.floor(cells[1][near]).astype(np.int32)
    if len(row) == 0:
        return None
    margin = VESSEL_GAP_CELLS // 2 + 2
    first_row, first_column = int(row.min()) - margin, int(column.min()) - margin
    shape = int(row.max()) - first_row + margin + 1, int(column.max()) - first_column + margin + 1
    occupied = np.zeros(shape, np.uint8)
    occupied[row - first_row, column - first_column] = 1
    grown = cv2.dilate(occupied, np.ones((3, 3), np.uint8))
    _, components = cv2.connectedComponents(grown, connectivity=4, ltype=cv2.CV_32S)
    labels = _join_vessels(occupied, np.asarray(components, np.int32))
    corner_m = axes.astype(np.float64) @ place_m + cell_m * np.array([first_row, first_column])
    return Footprints(axes, corner_m.astype(np.float32), cell_m, labels)


def _join_vessels(
    occupied: UInt8[np.ndarray, "rows columns"], labels: Int32[np.ndarray, "rows columns"]
) -> Int32[np.ndarray, "rows columns"]:
    """Give the footprints around each enclosed hole, and the hole, one label."""
    reach = VESSEL_GAP_CELLS // 2
    closed = cv2.dilate(occupied, np.ones((2 * reach + 1, 2 * reach + 1), np.uint8))
    count, holes, stats, _ = cv2.connectedComponentsWithStats(1 - closed, connectivity=4, ltype=cv2.CV_32S)
    # The outside touches the corner of the map, whose margin is free.
    outside = holes[0, 0]
    labels = labels.copy()
    for hole in range(1, count):
        if hole == outside:
            continue
        left, top, width, height = (int(stats[hole, column]) for column in range(4))
        around = (slice(top - reach, top + height + reach), slice(left - reach, left + width + reach))
        kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
        inside = cv2.dilate((holes[around] == hole).astype(np.uint8), kernel) > 0
        shares = np.bincount(labels[around][inside])
        shares[0] = 0
        # A neighbour seen through a gap of the wall is no part of it.
        walls = np.flatnonzero(shares > 0.1 * shares.sum())
        if len(walls):
            labels[np.isin(labels, walls)] = walls[0]
            labels[around][inside] = walls[0]
    return labels


def _horizontal_axes(up: Vector3) -> Float32[np.ndarray, "axes=2 3"]:
    """Two unit vectors across `up`; any will do."""
    helper = np.zeros(3)
    helper[int(np.argmin(np.abs(up)))] = 1.0
    first = np.cross(up, helper)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)]).astype(np.float32)
