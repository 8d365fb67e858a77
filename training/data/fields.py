"""Displacement fields as they are stored: on 32³ nodes, carried on a little beyond the body, and only near it.

A node is the middle of a block of 2³ voxels. A body fills a tenth of the cube, so a group keeps one mask of the nodes
near any of its bodies, and of each field only the values there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float16, Float32, UInt8

FIELD_SIZE = 32
"""Nodes along each edge of the cube."""

REACH = 2
"""Nodes that a field is carried on beyond the body: one voxel of looking up at the surface reads one of them, and a
smooth field is easier to learn than one that falls to zero at the surface."""

Field: TypeAlias = Float32[np.ndarray, "axis=3 x=32 y=32 z=32"]
Nodes: TypeAlias = Bool[np.ndarray, "x=32 y=32 z=32"]


def coarsen(
    fine: Float32[np.ndarray, "axis=3 x=64 y=64 z=64"],
) -> tuple[Field, UInt8[np.ndarray, "x=32 y=32 z=32"]]:
    """Mean of a field (NaN outside the body) over the voxels of each block that lie in the body, and their number."""
    inside = np.isfinite(fine[0])
    covered = coverage(inside)
    # pairwise sums along each axis: several times faster than one sum over three axes
    total = np.where(inside, fine, np.float32(0.0))
    total = total[:, :, :, ::2] + total[:, :, :, 1::2]
    total = total[:, :, ::2] + total[:, :, 1::2]
    total = total[:, ::2] + total[:, 1::2]
    return total / np.maximum(covered, 1).astype(np.float32), covered


def coverage(occupancy: Bool[np.ndarray, "x=64 y=64 z=64"]) -> UInt8[np.ndarray, "x=32 y=32 z=32"]:
    """How many of the eight voxels of each block are filled."""
    count = occupancy.view(np.uint8)
    count = count[:, :, ::2] + count[:, :, 1::2]
    count = count[:, ::2] + count[:, 1::2]
    return np.asarray(count[::2] + count[1::2])


def extend(field: Field, known: Nodes, reach: int = REACH) -> tuple[Field, Nodes]:
    """Carry a field on beyond the nodes where it is known, layer by layer.

    A node of a new layer gets the mean of the known ones among its 26 neighbours, the nearer ones weighing more
    (1, 2, 1 along each axis): normalised convolution.

    Returns:
        The field, zero where it is still unknown, and where it is known now.

    Source: H. Knutsson and C.-F. Westin, "Normalized and differential convolution" (CVPR 1993).
    """
    values = np.concatenate([np.where(known, field, np.float32(0.0)), known[None].astype(np.float32)])
    for _ in range(reach):
        smooth = values
        for axis in (1, 2, 3):
            smooth = _one_two_one(smooth, axis)
        new = (smooth[3] > 0.0) & (values[3] == 0.0)
        values[:, new] = smooth[:, new] / smooth[3, new]
    return values[:3], values[3] > 0.0


def _one_two_one(values: Float32[np.ndarray, "c x y z"], axis: int) -> Float32[np.ndarray, "c x y z"]:
    result = 2.0 * values
    ahead, behind = [slice(None)] * 4, [slice(None)] * 4
    ahead[axis], behind[axis] = slice(1, None), slice(None, -1)
    result[tuple(ahead)] += values[tuple(behind)]
    result[tuple(behind)] += values[tuple(ahead)]
    return np.asarray(result, np.float32)


def pack_nodes(nodes: Nodes) -> UInt8[np.ndarray, " 4096"]:
    """A mask of nodes as bits."""
    return np.packbits(nodes.ravel(), bitorder="little")


def unpack_nodes(bits: UInt8[np.ndarray, " 4096"]) -> Nodes:
    """The mask that `pack_nodes` packed."""
    return np.unpackbits(bits, bitorder="little").reshape((FIELD_SIZE,) * 3).astype(bool)


def pack_fields(fields: Sequence[Field], nodes: Nodes) -> Float16[np.ndarray, "n 3 k"]:
    """The values of each field at the k nodes of a mask."""
    return np.stack([field[:, nodes] for field in fields]).astype(np.float16)


def unpack_fields(
    values: Float16[np.ndarray, "n 3 k"], nodes: Nodes
) -> Float16[np.ndarray, "n 3 32 32 32"]:
    """Fields on all nodes, zero where the mask has none."""
    fields = np.zeros((len(values), 3, FIELD_SIZE**3), np.float16)
    fields[:, :, np.flatnonzero(nodes)] = values
    return fields.reshape(len(values), 3, *(FIELD_SIZE,) * 3)
