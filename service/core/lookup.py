"""Trilinear lookup of a 64³ field at arbitrary places, fast enough to do once for every voxel of a reply."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float32

from service.core.arrays import GRID_SIZE, Occupancy, Probability
from service.core.grids import Coordinate

PADDED = GRID_SIZE + 2
"""One voxel of zeros on every side stands for everything outside the grid."""


def trilinear(field: Probability, x: Coordinate, y: Coordinate, z: Coordinate) -> Probability:
    """Values of a field between its voxel centres; it falls to zero over one voxel outside the grid.

    Places are in voxels: the centre of voxel i lies at i.

    The grid is laid out as one tall image, slices of constant x below each other, in which OpenCV looks up the two
    slices on either side, bilinear in y and z and with all cores; the third interpolation is between the two. Weights
    are exact to 1/32 voxel, as OpenCV's are, in y and z.
    """
    atlas = np.pad(field, 1).reshape(PADDED * PADDED, PADDED)
    x, y, z = (np.clip(axis + np.float32(1), 0, np.float32(PADDED - 1)) for axis in (x, y, z))
    slice_below = np.minimum(np.floor(x), np.float32(PADDED - 2))
    row = (slice_below * np.float32(PADDED) + y).reshape(GRID_SIZE**2, GRID_SIZE)
    column = z.reshape(GRID_SIZE**2, GRID_SIZE)
    below = cv2.remap(atlas, column, row, cv2.INTER_LINEAR)
    above = cv2.remap(atlas, column, row + np.float32(PADDED), cv2.INTER_LINEAR)
    weight = (x - slice_below).reshape(GRID_SIZE**2, GRID_SIZE)
    result: Probability = (below + weight * (above - below)).reshape((GRID_SIZE,) * 3)
    return result


def warp(rest: Occupancy, displacement: Float32[np.ndarray, "axis=3 x=64 y=64 z=64"]) -> Probability:
    """Occupancy of the deformed body: the undeformed one, looked up at y - u(y).

    Args:
        rest: Undeformed body.
        displacement: Backward displacement u in edges of the grid.

    Returns:
        1 inside, 0 outside, in between within half a voxel of the surface.
    """
    steps = np.arange(GRID_SIZE, dtype=np.float32)
    source = displacement * np.float32(-GRID_SIZE)
    return trilinear(
        rest.astype(np.float32),
        source[0] + steps[:, None, None],
        source[1] + steps[:, None],
        source[2] + steps,
    )
