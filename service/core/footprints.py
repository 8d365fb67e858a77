"""Objects on a plane told apart by their footprints: what touches when seen from above is one object.

Neither holes in the depth image nor the jump from the rim of a cup to its inside split an object this way, and two
objects that overlap in the image but stand apart stay two.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32, Int32

from service.core.arrays import Points, Vector3

CELL_M = 0.004
"""Edge of a cell of the map, metres."""

CELL_PER_DEPTH = 0.006
"""The same per metre of depth, where that is more: noise and pixel spacing grow with it."""

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
        cells = (points @ self.axes.T - self.corner_m) * np.float32(1.0 / self.cell_m)
        rows, columns = self.labels.shape
        cells = np.clip(cells, -1.0, np.float32(max(rows, columns)), out=cells).astype(np.int32)
        # The outermost ring of cells is empty, so whatever lies outside the map may be read there.
        row = np.clip(cells[:, 0], 0, rows - 1)
        column = np.clip(cells[:, 1], 0, columns - 1)
        return np.asarray(self.labels[row, column], np.int32)


def find_footprints(points: Points, up: Vector3, place_m: Vector3) -> Footprints | None:
    """Map the footprints of points; gaps of up to two cells (8 mm, 1.2 % of the depth where that is more) are closed.

    Args:
        points: Points above the support, camera frame, metres.
        up: Unit vector against gravity.
        place_m: Where the object is about; the map is laid around it.

    Returns:
        The map, or None where no point lies within its reach.
    """
    axes = _horizontal_axes(up)
    cell_m = max(CELL_M, CELL_PER_DEPTH * abs(float(place_m[2])))
    horizontal = points @ axes.T
    centre = (axes.astype(np.float64) @ place_m).astype(np.float32)
    near = horizontal[(np.abs(horizontal - centre) < np.float32(REACH_CELLS * cell_m)).all(axis=1)]
    if len(near) == 0:
        return None
    low, high = near.min(axis=0), near.max(axis=0)
    # Two cells of margin: one for the dilation, one that stays empty.
    corner_m = low - np.float32(2.0 * cell_m)
    rows, columns = (math.ceil(float(extent) / cell_m) + 5 for extent in high - low)
    cells = ((near - corner_m) * np.float32(1.0 / cell_m)).astype(np.int32)
    occupied = np.zeros((rows, columns), np.uint8)
    occupied[cells[:, 0], cells[:, 1]] = 1
    grown = cv2.dilate(occupied, np.ones((3, 3), np.uint8))
    _, labels = cv2.connectedComponents(grown, connectivity=4, ltype=cv2.CV_32S)
    return Footprints(axes, corner_m, cell_m, np.asarray(labels, np.int32))


def _horizontal_axes(up: Vector3) -> Float32[np.ndarray, "axes=2 3"]:
    """Two unit vectors across `up`; any will do."""
    helper = np.zeros(3)
    helper[int(np.argmin(np.abs(up)))] = 1.0
    first = np.cross(up, helper)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(up, first)]).astype(np.float32)
