"""Decoding a body whose geometry the robot already has."""

from __future__ import annotations

import math

import numpy as np

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.errors import EmptyObject, InvalidShape
from service.core.grids import Grid, unpack_bits
from service.core.messages import KnownShape

MIN_VOXELS = 30
"""Fewer voxels than this are no body."""

RIGID_TOLERANCE = 1e-3
"""How far RᵀR may be from the identity: poses travel as decimal text."""


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
