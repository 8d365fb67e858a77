"""The displacement field of a load: what the coarse solve says, put right by what the network says."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from jaxtyping import Float32

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.compiled import compiled
from service.core.extent import Voxel, filled_range
from service.core.prior_field import FIELD_SIZE

Field: TypeAlias = Float32[np.ndarray, "axis=3 x=32 y=32 z=32"]
"""u in edges of the grid on a lattice over the cube, node i at (i + ½)/32."""

Lattice: TypeAlias = Float32[np.ndarray, "axis=3 s s s"]
Corner: TypeAlias = tuple[float, float, float]
Box: TypeAlias = tuple[Corner, Corner]
Vector: TypeAlias = tuple[np.float32, np.float32, np.float32]


def corrected(backward: Field, correction: Lattice, body: Box | None = None) -> Field:
    """The backward field of a body whose material has moved by a correction more than the field says.

    With ψ the map y ↦ y − u_b(y) back to rest and δ(x) the correction of the material at x, the material now at y was
    before at y − δ, so that u(y) = δ + u_b(y − δ) with δ taken at ψ(y). Nothing moves farther than it is high: what is
    on the floor is held there. Both fields are trilinear between their nodes; the last value holds outside.

    Args:
        backward: u_b in edges of the grid.
        correction: δ on a lattice over the cube, node i at (i + ½)/s.
        body: Box of the body at rest, lowest and highest corner in edges of the grid. Where none of it can get to,
            the field is left as it was. All of it is corrected if None.
    """
    first, end = _reached(body, backward, correction) if body else ((0, 0, 0), (FIELD_SIZE,) * 3)
    result = backward.copy()
    _correct(np.ascontiguousarray(backward), np.ascontiguousarray(correction), first, end, result)
    return result


def body_box(rest: Occupancy) -> Box:
    """Lowest and highest corner of a body, in edges of the grid.

    Raises:
        ValueError: It is empty.
    """
    found = filled_range(rest)
    if found is None:
        raise ValueError("an empty body has no box: the occupancy holds no voxel")
    (x0, y0, z0), (x1, y1, z1) = found
    return (x0 / GRID_SIZE, y0 / GRID_SIZE, z0 / GRID_SIZE), (x1 / GRID_SIZE, y1 / GRID_SIZE, z1 / GRID_SIZE)


def _reached(body: Box, backward: Field, correction: Lattice) -> tuple[Voxel, Voxel]:
    """The nodes around all places that some displacement there is could carry the body to."""
    ends = []
    for axis in range(3):
        low = body[0][axis] + float(backward[axis].min()) + float(correction[axis].min())
        high = body[1][axis] + float(backward[axis].max()) + float(correction[axis].max())
        first, end = math.floor(low * FIELD_SIZE - 1.5), math.ceil(high * FIELD_SIZE + 1.5)
        ends.append((min(max(first, 0), FIELD_SIZE - 1), max(min(end, FIELD_SIZE), 1)))
    (x0, x1), (y0, y1), (z0, z1) = ends
    return (x0, y0, z0), (x1, y1, z1)


_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
_NEXT = np.uintp(1)
_STEPS = ((np.arange(FIELD_SIZE) + 0.5) / FIELD_SIZE).astype(np.float32)


@compiled
def _correct(backward: Field, correction: Lattice, first: Voxel, end: Voxel, result: Field) -> None:
    """`corrected` at the nodes from `first` to before `end`."""
    for i in range(first[0], end[0]):
        for j in range(first[1], end[1]):
            for k in range(first[2], end[2]):
                x, y, z = _STEPS[i], _STEPS[j], _STEPS[k]
                dx, dy, dz = _vector_at(
                    correction, x - backward[0, i, j, k], y - backward[1, i, j, k], z - backward[2, i, j, k]
                )
                ux, uy, uz = _vector_at(backward, x - dx, y - dy, z - dz)
                ux, uy, uz = ux + dx, uy + dy, uz + dz
                squared = ux * ux + uy * uy + uz * uz
                held = z / np.sqrt(squared) if squared > z * z else _ONE
                result[0, i, j, k], result[1, i, j, k], result[2, i, j, k] = held * ux, held * uy, held * uz


@compiled
def _vector_at(lattice: Lattice, x: np.float32, y: np.float32, z: np.float32) -> Vector:
    """Trilinear lookup at a place in edges of the grid."""
    i, a = _cell_of(x, lattice.shape[1])
    j, b = _cell_of(y, lattice.shape[2])
    k, c = _cell_of(z, lattice.shape[3])
    p, q, r, s = (_ONE - a) * (_ONE - b), (_ONE - a) * b, a * (_ONE - b), a * b
    return (
        _mean(lattice, 0, i, j, k, p, q, r, s, c), _mean(lattice, 1, i, j, k, p, q, r, s, c),
        _mean(lattice, 2, i, j, k, p, q, r, s, c),
    )  # fmt: skip


@compiled
def _cell_of(place: np.float32, size: int) -> tuple[np.uintp, np.float32]:
    """The node below, and what the one above it counts for."""
    place = place * np.float32(size) - _HALF
    place = place if place > _ZERO else _ZERO  # nor is what is no number
    last = np.float32(size - 1)
    place = place if place < last else last
    below = min(np.int32(place), np.int32(size - 2))
    # an index without a sign is not looked at for counting from the end
    return np.uintp(below), place - np.float32(below)


@compiled
def _mean(
    lattice: Lattice, axis: int, i: np.uintp, j: np.uintp, k: np.uintp,
    p: np.float32, q: np.float32, r: np.float32, s: np.float32, c: np.float32,
) -> np.float32:  # fmt: skip
    """One component in a cell: p, q, r, s are the shares of its edges along z, c that of their upper ends."""
    low = (p * lattice[axis, i, j, k] + q * lattice[axis, i, j + _NEXT, k]) + (
        r * lattice[axis, i + _NEXT, j, k] + s * lattice[axis, i + _NEXT, j + _NEXT, k]
    )
    k += _NEXT
    high = (p * lattice[axis, i, j, k] + q * lattice[axis, i, j + _NEXT, k]) + (
        r * lattice[axis, i + _NEXT, j, k] + s * lattice[axis, i + _NEXT, j + _NEXT, k]
    )
    return np.float32(low + c * (high - low))
