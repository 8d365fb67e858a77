"""Displacement fields on their way from the coarse solve and the network to the voxels of an answer."""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float32

from service.core.arrays import GRID_SIZE, Occupancy

FIELD_SIZE = 32
"""Nodes of a backward field along each edge; node i lies at (i + ½)/32."""

Field = Float32[np.ndarray, "axis=3 x=32 y=32 z=32"]
Voxels = Float32[np.ndarray, "axis=3 x=64 y=64 z=64"]
Lattice = Float32[np.ndarray, "axis=3 s s s"]


def corrected(backward: Field, correction: Lattice) -> Field:
    """The backward field of a body whose material has moved by a correction more than the field says.

    With ψ the map y ↦ y − u_b(y) back to rest and δ(x) the correction of the material at x, the material now at y was
    before at y − δ, so that u(y) = δ + u_b(y − δ) with δ taken at ψ(y). Nothing moves farther than it is high: what is
    on the floor is held there.

    Args:
        backward: u_b in edges of the grid.
        correction: δ on a lattice over the cube, node i at (i + ½)/s.
    """
    nodes = _CENTRES
    moved = look_up(correction, nodes - backward)
    field = moved + look_up(backward, nodes - moved)
    length = np.sqrt(np.square(field).sum(axis=0))
    field *= np.minimum(1.0, nodes[2] / np.maximum(length, np.float32(1e-12)))
    return np.asarray(field)


def look_up(lattice: Lattice, points: Field) -> Field:
    """Trilinear lookup of a vector field at the places of another; the last value holds outside.

    The lattice is laid out as one tall image, slices of constant x below each other, in which OpenCV looks up the two
    slices on either side, bilinear in y and z; weights are exact to 1/32 of a lattice cell there.
    """
    size = lattice.shape[1]
    image = np.ascontiguousarray(lattice.transpose(1, 2, 3, 0)).reshape(size * size, size, 3)
    place = np.clip(points * np.float32(size) - np.float32(0.5), 0.0, size - 1.0).reshape(3, FIELD_SIZE**2, FIELD_SIZE)
    below = np.minimum(np.floor(place[0]), np.float32(size - 2))
    row = below * np.float32(size) + place[1]
    weight = (place[0] - below)[:, :, None]
    lower = np.asarray(cv2.remap(image, place[2], row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
    row += np.float32(size)
    upper = np.asarray(cv2.remap(image, place[2], row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))
    found = lower + weight * (upper - lower)
    return np.ascontiguousarray(found.transpose(2, 0, 1)).reshape(points.shape)


def at_voxels(field: Field, rest: Occupancy) -> Voxels:
    """The field between its nodes, at the centre of every voxel; the lowest voxels of the body at rest do not move.

    They lie half a voxel above what is clamped.
    """
    fine: Voxels = np.matmul(_UPSAMPLING, np.matmul(_UPSAMPLING, field @ _UPSAMPLING.T).reshape(3, FIELD_SIZE, -1))
    fine = fine.reshape(3, *(GRID_SIZE,) * 3)
    fine[..., 0] *= ~rest[..., 0]
    return fine


def _upsampling() -> Float32[np.ndarray, "voxels nodes"]:
    """Linear interpolation from the nodes of a field to the centres of voxels, held at the ends."""
    place = np.clip((np.arange(GRID_SIZE) + 0.5) * FIELD_SIZE / GRID_SIZE - 0.5, 0.0, FIELD_SIZE - 1.0)
    below = np.minimum(np.floor(place).astype(int), FIELD_SIZE - 2)
    table = np.zeros((GRID_SIZE, FIELD_SIZE), np.float32)
    table[np.arange(GRID_SIZE), below] = 1.0 - (place - below)
    table[np.arange(GRID_SIZE), below + 1] = place - below
    return table


_UPSAMPLING = _upsampling()
_STEPS = ((np.arange(FIELD_SIZE) + 0.5) / FIELD_SIZE).astype(np.float32)
_CENTRES: Field = np.stack(np.meshgrid(_STEPS, _STEPS, _STEPS, indexing="ij"))
