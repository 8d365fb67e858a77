"""Decoding a body whose geometry the robot already has."""

from __future__ import annotations

import math

import numpy as np

from service.core.alignment import HORIZONTAL_FILL, VERTICAL_FILL
from service.core.arrays import GRID_SIZE, Occupancy, Vector3
from service.core.errors import EmptyObject, InvalidShape
from service.core.grids import Grid, unpack_bits
from service.core.messages import KnownShape

MIN_VOXELS = 30
"""Fewer voxels than this are no body."""

RIGID_TOLERANCE = 1e-3
"""How far RᵀR may be from the identity: poses travel as decimal text."""

UPRIGHT = math.cos(math.radians(1.0))
"""A z axis this near to `up` points up: over the height of a body the two part by a voxel at most."""

OWN_FILL = (0.5, 1.16)
"""Part of what a body fills of its body grid that it has to fill of its own to be answered there: with less the
fields, whose nodes lie in the grid, are too coarse for it; with more it has no room to deform into."""


def decode_shape(shape: KnownShape) -> tuple[Occupancy, Grid]:
    """Bits, voxel size and pose to a body in its grid.

    Raises:
        InvalidShape: Wrong number of bytes, a voxel size that is not a positive length, or a pose that is not rigid.
        EmptyObject: Fewer than 30 voxels are filled.
    """
    expected = GRID_SIZE**3 // 8
    if len(shape.data) != expected:
        raise InvalidShape(
            "The shape must hold 64³ bits.", field="shape.data", expected=f"{expected} bytes", actual=len(shape.data)
        )
    if not (math.isfinite(shape.pitch_m) and shape.pitch_m > 0):
        raise InvalidShape(
            "The voxel size must be a positive length in metres.",
            field="shape.voxel_size_m", expected="> 0", actual=str(shape.pitch_m),
        )  # fmt: skip
    pose = np.asarray(shape.camera_from_grid, np.float64)
    rotation = pose[:3, :3]
    if (
        not np.isfinite(pose).all()
        or np.abs(rotation.T @ rotation - np.eye(3)).max() > RIGID_TOLERANCE
        or np.linalg.det(rotation) < 0
        or np.abs(pose[3] - [0.0, 0.0, 0.0, 1.0]).max() > RIGID_TOLERANCE
    ):
        raise InvalidShape(
            "The pose of the shape must be a rotation and a translation.",
            field="shape.camera_from_grid",
            expected="a rigid 4x4 transform",
        )
    occupancy = unpack_bits(np.frombuffer(shape.data, np.uint8))
    filled = int(occupancy.sum())
    if filled < MIN_VOXELS:
        raise EmptyObject(
            "The shape is empty.", field="shape.data", expected=f"at least {MIN_VOXELS} voxels", actual=filled
        )
    return occupancy, Grid(pitch_m=shape.pitch_m, camera_from_grid=pose)


def in_own_voxels(occupancy: Occupancy, grid: Grid, up: Vector3 | None = None) -> tuple[Occupancy, Grid] | None:
    """The body in its own voxels, for a grid that can serve as its body grid but for how it is turned.

    The grid is moved by whole voxels until the body stands in the middle of its floor: the voxels stay what they were.
    Turned into a grid of its principal axes and looked up again in the robot's, voxels cost 0.04 of the overlap of a
    deformed body with the true one.

    Args:
        occupancy: The body, not empty.
        grid: Where its voxels are.
        up: Direction against gravity in the camera frame; None for the z axis of `grid`.

    Returns:
        None where `grid` is not upright, or the body is too small or too large in it (`OWN_FILL`).
    """
    if up is not None and float(grid.camera_from_grid[:3, 2] @ up) < UPRIGHT * float(np.linalg.norm(up)):
        return None
    filled = [np.flatnonzero(occupancy.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1))]
    low = np.array([index[0] for index in filled])
    extent = np.array([index[-1] for index in filled]) + 1 - low
    fill = float((extent / [HORIZONTAL_FILL, HORIZONTAL_FILL, VERTICAL_FILL]).max()) / GRID_SIZE
    if not OWN_FILL[0] <= fill <= OWN_FILL[1]:
        return None
    shift = np.trunc(low + (extent - GRID_SIZE) / 2).astype(int)  # half a voxel off the middle it stays
    shift[2] = low[2]
    if not shift.any():
        return occupancy, grid
    moved = np.zeros_like(occupancy)
    to, of = (tuple(slice(a, a + n) for a, n in zip(start, extent, strict=True)) for start in (low - shift, low))
    moved[to] = occupancy[of]
    pose = grid.camera_from_grid.copy()
    pose[:3, 3] += pose[:3, :3] @ (shift * grid.pitch_m)
    return moved, Grid(pitch_m=grid.pitch_m, camera_from_grid=pose)
