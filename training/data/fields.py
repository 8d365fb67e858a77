"""Displacement fields as they are stored: on 32³ nodes, carried on a little beyond the body, and only near it.

A node is the middle of a block of 2³ voxels. A body fills a tenth of the cube, so a group keeps one mask of the nodes
near any of its bodies, and of each field only the values there.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float16, Float32, Float64, Int, UInt8

from service.core.compiled import compiled

FIELD_SIZE = 32
"""Nodes along each edge of the cube."""

REACH = 2
"""Nodes that a field is carried on beyond the body: one voxel of looking up at the surface reads one of them, and a
smooth field is easier to learn than one that falls to zero at the surface."""

Field: TypeAlias = Float32[np.ndarray, "axis=3 x=32 y=32 z=32"]
Nodes: TypeAlias = Bool[np.ndarray, "x=32 y=32 z=32"]


def coarsen(
    index: Int[np.ndarray, " n"], values: Float32[np.ndarray, "n 3"]
) -> tuple[Field, UInt8[np.ndarray, "x=32 y=32 z=32"]]:
    """Mean of a field over the voxels of each block that lie in the body, and their number.

    Args:
        index: Places of the body's voxels in the flat grid of 64³.
        values: The field there.
    """
    mean = np.zeros((3, *(FIELD_SIZE,) * 3), np.float32)
    covered = np.zeros((FIELD_SIZE,) * 3, np.uint8)
    _coarsen(index, values, mean, covered)
    return mean, covered


def block_means(
    index: Int[np.ndarray, " n"], values: Float64[np.ndarray, " n"]
) -> Float64[np.ndarray, "x=32 y=32 z=32"]:
    """Mean of a scalar over the voxels of each block that are given, zero where none is."""
    i, j, k = index >> 13, index >> 7 & 31, index >> 1 & 31
    node = i << 10 | j << 5 | k
    total = np.bincount(node, values, FIELD_SIZE**3)
    return np.asarray(total / np.maximum(np.bincount(node, minlength=FIELD_SIZE**3), 1)).reshape((FIELD_SIZE,) * 3)


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
    # a rim of unknown nodes, so that every node has 26 neighbours
    layer = np.zeros(tuple(edge + 2 for edge in known.shape), np.uint8)
    layer[1:-1, 1:-1, 1:-1] = known
    values = np.zeros(field.shape, np.float32)
    _extend(field, values, layer, np.argwhere(known), reach)
    return values, layer[1:-1, 1:-1, 1:-1] > 0


@compiled
def _coarsen(
    index: Int[np.ndarray, " n"],
    values: Float32[np.ndarray, "n 3"],
    mean: Field,
    covered: UInt8[np.ndarray, "x=32 y=32 z=32"],
) -> None:
    size = 2 * covered.shape[0]
    for row in range(len(index)):
        i, j, k = index[row] // size**2 // 2, index[row] // size % size // 2, index[row] % size // 2
        covered[i, j, k] += 1
        for axis in range(3):
            mean[axis, i, j, k] += values[row, axis]
    for i in range(covered.shape[0]):
        for j in range(covered.shape[1]):
            for k in range(covered.shape[2]):
                if covered[i, j, k] > 1:
                    for axis in range(3):
                        mean[axis, i, j, k] /= covered[i, j, k]


@compiled
def _extend(
    field: Field,
    values: Field,
    layer: UInt8[np.ndarray, "x=34 y=34 z=34"],
    front: Int[np.ndarray, "n 3"],
    reach: int,
) -> None:
    """Write `values` at the nodes of `front` and of `reach` layers around them, whose numbers go into `layer`.

    Args:
        field: Known at the nodes of `front`.
        values: Zero before.
        layer: Number of the layer of each node, with a rim around them: 1 for those of `front`, else 0.
        front: Index of the nodes that are known, in the end of those of the last layer.
        reach: Layers.
    """
    nx, ny, nz = values.shape[1], values.shape[2], values.shape[3]
    for row in range(len(front)):
        i, j, k = front[row, 0], front[row, 1], front[row, 2]
        for axis in range(3):
            values[axis, i, j, k] = field[axis, i, j, k]
    nodes = np.empty((nx * ny * nz, 3), np.int16)
    for number in range(2, 2 + reach):
        count = 0
        for row in range(len(front)):
            for a in range(max(front[row, 0] - 1, 0), min(front[row, 0] + 2, nx)):
                for b in range(max(front[row, 1] - 1, 0), min(front[row, 1] + 2, ny)):
                    for c in range(max(front[row, 2] - 1, 0), min(front[row, 2] + 2, nz)):
                        if layer[a + 1, b + 1, c + 1] == 0:
                            layer[a + 1, b + 1, c + 1] = number
                            nodes[count, 0], nodes[count, 1], nodes[count, 2] = a, b, c
                            count += 1
        front = nodes[:count].astype(np.int64)
        for row in range(count):
            i, j, k = front[row, 0], front[row, 1], front[row, 2]
            total, x, y, z = 0.0, 0.0, 0.0, 0.0
            for a in range(-1, 2):
                for b in range(-1, 2):
                    for c in range(-1, 2):
                        other = layer[i + a + 1, j + b + 1, k + c + 1]
                        if other == 0 or other == number:
                            continue
                        weight = (2.0 - abs(a)) * (2.0 - abs(b)) * (2.0 - abs(c))
                        total += weight
                        x += weight * values[0, i + a, j + b, k + c]
                        y += weight * values[1, i + a, j + b, k + c]
                        z += weight * values[2, i + a, j + b, k + c]
            values[0, i, j, k], values[1, i, j, k], values[2, i, j, k] = x / total, y / total, z / total


def pack_nodes(nodes: Nodes) -> UInt8[np.ndarray, " 4096"]:
    """A mask of nodes as bits."""
    return np.packbits(nodes.ravel(), bitorder="little")


def unpack_nodes(bits: UInt8[np.ndarray, " 4096"]) -> Nodes:
    """The mask that `pack_nodes` packed."""
    return np.unpackbits(bits, bitorder="little").reshape((FIELD_SIZE,) * 3).astype(bool)


def pack_fields(fields: Sequence[Field], nodes: Nodes) -> Float16[np.ndarray, "n 3 k"]:
    """The values of each field at the k nodes of a mask."""
    return np.stack([field[:, nodes] for field in fields]).astype(np.float16)


def unpack_fields(values: Float16[np.ndarray, "n 3 k"], nodes: Nodes) -> Float16[np.ndarray, "n 3 32 32 32"]:
    """Fields on all nodes, zero where the mask has none."""
    fields = np.zeros((len(values), 3, FIELD_SIZE**3), np.float16)
    fields[:, :, np.flatnonzero(nodes)] = values
    return fields.reshape(len(values), 3, *(FIELD_SIZE,) * 3)
