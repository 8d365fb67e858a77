"""Array types of the public functions: shape, axis order and dtype, checked by beartype in the tests."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8, UInt64

GRID_SIZE = 64
"""Voxels along each edge of every grid the service takes or returns."""

Occupancy: TypeAlias = Bool[np.ndarray, "x=64 y=64 z=64"]
Bytes: TypeAlias = UInt8[np.ndarray, "x=64 y=64 z=64"]
"""Occupancy seen as numbers."""
Eights: TypeAlias = UInt64[np.ndarray, "x=64 y=64 eight=8"]
"""Occupancy seen eight voxels at a time: 0 where none of them is filled."""
Probability: TypeAlias = Float32[np.ndarray, "x=64 y=64 z=64"]
PackedOccupancy: TypeAlias = UInt8[np.ndarray, "bytes=32768"]

DepthImage: TypeAlias = Float32[np.ndarray, "height width"]
"""Metres along the optical axis; NaN where the sensor gave no reading."""
Mask: TypeAlias = Bool[np.ndarray, "height width"]

Points: TypeAlias = Float32[np.ndarray, "n 3"]
Vector3: TypeAlias = Float64[np.ndarray, "3"]
Matrix3: TypeAlias = Float64[np.ndarray, "3 3"]
Transform: TypeAlias = Float64[np.ndarray, "4 4"]
