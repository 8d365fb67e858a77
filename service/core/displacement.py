"""The displacement field of a load: what the coarse solve says, put right by what the network says."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from jaxtyping import Float32

from service.core.arrays import GRID_SIZE
from service.core.compiled import compiled
from service.core.extent import Voxel
from service.core.prior_field import FIELD_SIZE
from service.core.spread import Spread, in_turn

Field: TypeAlias = Float32[np.ndarray, "axis=3 x=32 y=32 z=32"]
"""u in edges of the grid on a lattice over the cube, node i at (i + ½)/32."""

Lattice: TypeAlias = Float32[np.ndarray, "axis=3 s s s"]
Corner: TypeAlias = tuple[float, float, float]
Box: TypeAlias = tuple[Corner, Corner]
Vector: TypeAlias = tuple[np.float32, np.float32, np.float32]

SPARE = 3.0
"""Nodes around all material that is looked at: a cell of the field, and as much again as the field may bend in it."""


def corrected(
    backward: Field, correction: Lattice, body: Box | None = None, spread: Spread = in_turn, result: Field | None = None
) -> Field:
    """The backward field of a body whose material has moved by a correction more than the field says.

    With ψ the map y ↦ y − u_b(y) back to rest and δ(x) the correction of the material at x, the material now at y was
    before at y − δ, so that u(y) = δ + u_b(y − δ) with δ taken at ψ(y). Nothing moves farther than it is high: what is
    on the floor is held there. Both fields are trilinear between their nodes; the last value holds outside.

    Args:
        backward: u_b in edges of the grid.
        correction: δ on a lattice over the cube, node i at (i + ½)/s.
        body: Box of the body at rest, lowest and highest corner in edges of the grid. The field is left as it was where
            ψ leads farther from the box than the body is corrected, and `SPARE` nodes: nobody looks there. All of it
            is corrected if None.
        spread: Over the nodes along x.
        result: To be written over and returned; a new one if None.
    """
    low, high = _near(body, correction) if body else (_NOWHERE, _EVERYWHERE)
    backward, correction = np.ascontiguousarray(backward), np.ascontiguousarray(correction)
    field = np.empty_like(backward) if result is None else result
    spread(lambda first, end: _correct(backward, correction, low, high, first, end, field), FIELD_SIZE)
    return field


def box_between(first: Voxel, end: Voxel) -> Box:
    """The box of voxels from one to before another, in edges of the grid."""
    (x0, y0, z0), (x1, y1, z1) = first, end
    return (x0 / GRID_SIZE, y0 / GRID_SIZE, z0 / GRID_SIZE), (x1 / GRID_SIZE, y1 / GRID_SIZE, z1 / GRID_SIZE)


def _near(body: Box, correction: Lattice) -> tuple[Vector, Vector]:
    """The box, and around it what the correction inside can amount to. Far from the body there is no bound to it."""
    size = correction.shape[1]
    first = [max(math.floor(size * place - 0.5), 0) for place in body[0]]
    end = [math.ceil(size * place + 0.5) for place in body[1]]
    there = correction[:, first[0] : end[0], first[1] : end[1], first[2] : end[2]]
    around = SPARE / FIELD_SIZE + max(float(there.max()), -float(there.min()))
    (x, y, z), (end_x, end_y, end_z) = body
    return _vector(x - around, y - around, z - around), _vector(end_x + around, end_y + around, end_z + around)


def _vector(x: float, y: float, z: float) -> Vector:
    return np.float32(x), np.float32(y), np.float32(z)


_NOWHERE, _EVERYWHERE = _vector(-math.inf, -math.inf, -math.inf), _vector(math.inf, math.inf, math.inf)
_ZERO, _HALF, _ONE = np.float32(0.0), np.float32(0.5), np.float32(1.0)
_NEXT = np.uintp(1)
_STEPS = ((np.arange(FIELD_SIZE) + 0.5) / FIELD_SIZE).astype(np.float32)


@compiled
def _correct(
    backward: Field, correction: Lattice, low: Vector, high: Vector, first: int, end: int, result: Field
) -> None:
    """`corrected` at the nodes, of some along x, whose material the field says to come from between two corners."""
    for i in range(first, end):
        for j in range(FIELD_SIZE):
            for k in range(FIELD_SIZE):
                x, y, z = _STEPS[i], _STEPS[j], _STEPS[k]
                ux, uy, uz = backward[0, i, j, k], backward[1, i, j, k], backward[2, i, j, k]
                at_x, at_y, at_z = x - ux, y - uy, z - uz
                outside_x, outside_y = at_x < low[0] or at_x > high[0], at_y < low[1] or at_y > high[1]
                if not (outside_x or outside_y or at_z < low[2] or at_z > high[2]):
                    dx, dy, dz = _vector_at(correction, at_x, at_y, at_z)
                    ux, uy, uz = _vector_at(backward, x - dx, y - dy, z - dz)
                    ux, uy, uz = ux + dx, uy + dy, uz + dz
                    squared = ux * ux + uy * uy + uz * uz
                    held = z / np.sqrt(squared) if squared > z * z else _ONE
                    ux, uy, uz = held * ux, held * uy, held * uz
                result[0, i, j, k], result[1, i, j, k], result[2, i, j, k] = ux, uy, uz


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
