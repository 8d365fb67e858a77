"""Displacement fields on their way from the coarse solve and the network to the voxels of an answer."""

from __future__ import annotations

import math
from typing import TypeAlias

import cv2
import numpy as np
from jaxtyping import Float32

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.prior_field import FIELD_SIZE, interpolation

Field = Float32[np.ndarray, "axis=3 x=32 y=32 z=32"]
Voxels = Float32[np.ndarray, "axis=3 x=64 y=64 z=64"]
Lattice = Float32[np.ndarray, "axis=3 s s s"]
Places = Float32[np.ndarray, "axis=3 a b c"]
Corner: TypeAlias = tuple[float, float, float]
Box: TypeAlias = tuple[Corner, Corner]


def corrected(backward: Field, correction: Lattice, body: Box | None = None) -> Field:
    """The backward field of a body whose material has moved by a correction more than the field says.

    With ψ the map y ↦ y − u_b(y) back to rest and δ(x) the correction of the material at x, the material now at y was
    before at y − δ, so that u(y) = δ + u_b(y − δ) with δ taken at ψ(y). Nothing moves farther than it is high: what is
    on the floor is held there.

    Args:
        backward: u_b in edges of the grid.
        correction: δ on a lattice over the cube, node i at (i + ½)/s.
        body: Box of the body at rest, lowest and highest corner in edges of the grid. Where none of it can get to,
            the field is left as it was. All of it is corrected if None.
    """
    part = (slice(None), *(_reached(body, backward, correction) if body else (slice(None),) * 3))
    nodes = _CENTRES[part]
    moved = look_up(correction, nodes - backward[part])
    field = moved + look_up(backward, nodes - moved)
    length = np.sqrt(np.square(field).sum(axis=0))
    field *= np.minimum(1.0, nodes[2] / np.maximum(length, np.float32(1e-12)))
    result = backward.copy()
    result[part] = field
    return result


def body_box(rest: Occupancy) -> Box:
    """Lowest and highest corner of a body, in edges of the grid."""
    filled = [np.flatnonzero(rest.any(axis=axes)) for axes in ((1, 2), (0, 2), (0, 1))]
    low, high = zip(*((int(axis[0]) / GRID_SIZE, (int(axis[-1]) + 1) / GRID_SIZE) for axis in filled), strict=True)
    return (low[0], low[1], low[2]), (high[0], high[1], high[2])


def _reached(body: Box, backward: Field, correction: Lattice) -> tuple[slice, slice, slice]:
    """The nodes around all places that some displacement there is could carry the body to."""
    slices = []
    for axis in range(3):
        low = body[0][axis] + float(backward[axis].min()) + float(correction[axis].min())
        high = body[1][axis] + float(backward[axis].max()) + float(correction[axis].max())
        first, end = math.floor(low * FIELD_SIZE - 1.5), math.ceil(high * FIELD_SIZE + 1.5)
        slices.append(slice(min(max(first, 0), FIELD_SIZE - 1), max(min(end, FIELD_SIZE), 1)))
    return slices[0], slices[1], slices[2]


def look_up(lattice: Lattice, points: Places) -> Places:
    """Trilinear lookup of a vector field at places in edges of the grid; the last value holds outside.

    The lattice is laid out as one tall image, slices of constant x below each other, in which OpenCV looks up the two
    slices on either side, bilinear in y and z; weights are exact to 1/32 of a lattice cell there.
    """
    size = lattice.shape[1]
    image = np.ascontiguousarray(lattice.transpose(1, 2, 3, 0)).reshape(size * size, size, 3)
    place = np.clip(points * np.float32(size) - np.float32(0.5), 0.0, size - 1.0)
    place = place.reshape(3, -1, points.shape[3])
    below = np.minimum(np.floor(place[0]), np.float32(size - 2))
    row = below * np.float32(size) + place[1]
    weight = (place[0] - below)[:, :, None]
    lower = np.asarray(cv2.remap(image, place[2], row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
    row += np.float32(size)
    upper = np.asarray(cv2.remap(image, place[2], row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float32)
    upper -= lower
    upper *= weight
    upper += lower
    return np.ascontiguousarray(upper.transpose(2, 0, 1)).reshape(points.shape)


def at_voxels(field: Field, rest: Occupancy) -> Voxels:
    """The field between its nodes, at the centre of every voxel; the lowest voxels of the body at rest do not move.

    They lie half a voxel above what is clamped.
    """
    fine: Voxels = np.matmul(_UPSAMPLING, np.matmul(_UPSAMPLING, field @ _UPSAMPLING.T).reshape(3, FIELD_SIZE, -1))
    fine = fine.reshape(3, *(GRID_SIZE,) * 3)
    fine[..., 0] *= ~rest[..., 0]
    return fine


_UPSAMPLING = interpolation(FIELD_SIZE, GRID_SIZE, continued=False)
_STEPS = ((np.arange(FIELD_SIZE) + 0.5) / FIELD_SIZE).astype(np.float32)
_CENTRES: Field = np.stack(np.meshgrid(_STEPS, _STEPS, _STEPS, indexing="ij"))
