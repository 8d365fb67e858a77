"""Where a cube of 64³ voxels sits in the camera's metric frame, and how its bits travel."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from jaxtyping import Float32, Int32, Shaped

from service.core.arrays import GRID_SIZE, Matrix3, Occupancy, PackedOccupancy, Points, Transform, Vector3

Coordinate: TypeAlias = Float32[np.ndarray, "x=64 y=64 z=64"]
"""One coordinate of a place for each voxel of a grid."""


@dataclass(frozen=True)
class Grid:
    """A cube of 64³ voxels.

    Voxel (i, j, k) has its centre at ((i+½), (j+½), (k+½))·pitch_m in the grid's own frame; arrays are indexed
    [x, y, z] in C order.

    Attributes:
        pitch_m: Edge of one voxel in metres, positive.
        camera_from_grid: Rigid transform from the grid's metric frame to the camera's optical frame.
    """

    pitch_m: float
    camera_from_grid: Transform

    @property
    def edge_m(self) -> float:
        """Edge of the whole cube, L, in metres."""
        return self.pitch_m * GRID_SIZE

    @cached_property
    def grid_from_camera(self) -> Transform:
        """The inverse of `camera_from_grid`; not to be written to."""
        return invert_rigid(self.camera_from_grid)


def invert_rigid(b_from_a: Transform) -> Transform:
    """Inverse of a rigid transform, by its transpose (exact to rounding, unlike a general inverse)."""
    a_from_b, rotation = np.empty((4, 4)), b_from_a[:3, :3].T
    a_from_b[:3, :3], a_from_b[:3, 3], a_from_b[3] = rotation, -rotation @ b_from_a[:3, 3], (0.0, 0.0, 0.0, 1.0)
    return a_from_b


def cross(a: Vector3, b: Vector3) -> Vector3:
    """Cross product a × b, without the time that `np.cross` needs to find out which axes its arguments have."""
    return np.array(crossed(a.tolist(), b.tolist()))


def crossed(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float]:
    """The same of plain numbers, three each."""
    (ax, ay, az), (bx, by, bz) = a, b
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


def transform_points(b_from_a: Transform, points_a: Points) -> Points:
    """Apply a rigid transform to n points."""
    rotation = b_from_a[:3, :3].astype(np.float32)
    return np.asarray(points_a @ rotation.T + b_from_a[:3, 3].astype(np.float32), np.float32)


def centres_seen_from(rotation: Matrix3, pitch: float, origin: Vector3) -> tuple[Coordinate, Coordinate, Coordinate]:
    """Voxel centres of a grid in another frame, one array an axis, from three broadcast sums.

    Args:
        rotation: Axes of the grid in that frame.
        pitch: Edge of a voxel in that frame's unit of length.
        origin: Corner of the grid in that frame.
    """
    steps = (np.arange(GRID_SIZE) + 0.5) * pitch
    columns = (rotation[:, :, None] * steps).astype(np.float32)  # axis of the frame, axis of the grid, step
    start = origin.astype(np.float32)
    x, y, z = (
        (columns[axis, 0] + start[axis])[:, None, None] + columns[axis, 1][:, None] + columns[axis, 2]
        for axis in range(3)
    )
    return x, y, z


def filled_voxels(occupancy: Occupancy) -> Int32[np.ndarray, "axis=3 n"]:
    """Indices (i, j, k) of the filled voxels in C order, one axis a row: the transpose of `np.argwhere`, in a tenth of
    its time.
    """
    voxel = np.flatnonzero(occupancy).astype(np.int32)
    column = voxel // GRID_SIZE
    row = column // GRID_SIZE
    return np.stack([row, column - GRID_SIZE * row, voxel - GRID_SIZE * column])


def on_grid(
    vectors: Shaped[np.ndarray, "axis=3 n"], occupancy: Occupancy
) -> Shaped[np.ndarray, "axis=3 x=64 y=64 z=64"]:
    """Vectors of the filled voxels, those in C order, on a grid that is zero elsewhere."""
    grid = np.zeros((3, GRID_SIZE**3), vectors.dtype)
    grid[:, np.flatnonzero(occupancy)] = vectors
    return grid.reshape(3, GRID_SIZE, GRID_SIZE, GRID_SIZE)


def pack_bits(occupancy: Occupancy) -> PackedOccupancy:
    """64³ voxels to 32 KiB, least significant bit first, C order."""
    return np.packbits(occupancy.ravel(), bitorder="little")


def unpack_bits(packed: PackedOccupancy) -> Occupancy:
    """Inverse of `pack_bits`."""
    return np.unpackbits(packed, bitorder="little").reshape((GRID_SIZE,) * 3).view(np.bool_)
