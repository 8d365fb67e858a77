"""A displacement field at the voxels of a grid, one column after the other.

Nodes are two voxels apart, so a voxel lies a quarter of the way between two of them along each axis: the voxels of a
slab of one x are found on the nodes in y first, each column from its two nodes then.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from jaxtyping import Float32

from service.core.arrays import GRID_SIZE
from service.core.compiled import compiled
from service.core.displacement import Field
from service.core.prior_field import FIELD_SIZE

Row: TypeAlias = Float32[np.ndarray, "node=32"]
Slab: TypeAlias = Float32[np.ndarray, "axis=3 node=32 z=64"]
Column: TypeAlias = Float32[np.ndarray, "axis=3 z=64"]

_QUARTER, _THREE_QUARTERS = np.float32(0.25), np.float32(0.75)


@compiled
def scratch() -> tuple[Row, Slab, Column]:
    """Room for a row of nodes, for a slab of one x as `fill_slab` fills it, and for one column of voxels."""
    return (
        np.empty(FIELD_SIZE, np.float32), np.empty((3, FIELD_SIZE, GRID_SIZE), np.float32),
        np.empty((3, GRID_SIZE), np.float32),
    )  # fmt: skip


@compiled
def _node_below(voxel: int) -> tuple[int, int, np.float32]:
    """The nodes on either side of a voxel, and what the upper one counts for: ¼ or ¾."""
    below = (voxel + 1) // 2 - 1
    return max(below, 0), min(below + 1, FIELD_SIZE - 1), _QUARTER if voxel % 2 else _THREE_QUARTERS


@compiled
def fill_slab(field: Field, x: int, first: int, end: int, end_z: int, coarse: Row, slab: Slab) -> None:
    """The field at voxels x and z, on the nodes around the voxels from `first` to before `end` in y."""
    lower, upper, a = _node_below(x)
    nodes = min(end_z // 2 + 1, FIELD_SIZE)
    for axis in range(3):
        for j in range(_node_below(first)[0], _node_below(end - 1)[1] + 1):
            for k in range(nodes):
                coarse[k] = field[axis, lower, j, k] + a * (field[axis, upper, j, k] - field[axis, lower, j, k])
            slab[axis, j, 0] = coarse[0]
            for k in range(nodes - 1):
                slab[axis, j, 2 * k + 1] = _THREE_QUARTERS * coarse[k] + _QUARTER * coarse[k + 1]
                slab[axis, j, 2 * k + 2] = _QUARTER * coarse[k] + _THREE_QUARTERS * coarse[k + 1]
            slab[axis, j, GRID_SIZE - 1] = coarse[nodes - 1]


@compiled
def fill_column(slab: Slab, clamped: bool, y: int, end: int, u: Column) -> None:
    """The field at the voxels of one column below `end`; its lowest one does not move where it is clamped."""
    lower, upper, b = _node_below(y)
    for axis in range(3):
        for z in range(end):
            u[axis, z] = slab[axis, lower, z] + b * (slab[axis, upper, z] - slab[axis, lower, z])
        if clamped:
            u[axis, 0] = 0.0
