"""The displacement field of a load: what the coarse solve says, put right by what the network says."""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from jaxtyping import Float32, Int32

from service.core.arrays import GRID_SIZE
from service.core.compiled import compiled
from service.core.extent import Voxel
from service.core.prior_field import FIELD_SIZE

Field: TypeAlias = Float32[np.ndarray, "axis=3 x=32 y=32 z=32"]
"""u in edges of the grid on a lattice over the cube, node i at (i + ½)/32."""

Lattice: TypeAlias = Float32[np.ndarray, "axis=3 s s s"]
Corner: TypeAlias = tuple[float, float, float]
Box: TypeAlias = tuple[Corner, Corner]
Vector: TypeAlias = tuple[np.float32, np.float32, np.float32]
Row: TypeAlias = Float32[np.ndarray, "axis=3 node=32"]
Shares: TypeAlias = Float32[np.ndarray, "5 node=32"]

STEPS = ((np.arange(FIELD_SIZE) + 0.5) / FIELD_SIZE).astype(np.float32)
"""Places of the field's nodes along an axis, in edges of the grid."""

SPARE = 3.0
"""Nodes around all material that is looked at: a cell of the field, and as much again as the field may bend in it."""


def corrected(backward: Field, correction: Lattice, body: Box | None = None) -> Field:
    """The backward field of a body whose material has moved by a correction more than the field says.

    With ψ the map y ↦ y − u_b(y) back to rest and δ(x) the correction of the material at x, the material now at y was
    before at y − δ, so that u(y) = δ + u_b(y − δ) with δ taken at ψ(y). Nothing is corrected by more than its height at
    rest: what stands on the floor is held there by the solve. Both fields are trilinear between their nodes; the last
    value holds outside.

    Args:
        backward: u_b in edges of the grid.
        correction: δ on a lattice over the cube, node i at (i + ½)/s.
        body: Box of the body at rest, lowest and highest corner in edges of the grid. The field is left as it was where
            ψ leads farther from the box than the body is corrected, and `SPARE` nodes: nobody looks there. All of it
            is corrected if None.
    """
    low, high = corners(body, correction)
    backward, correction = np.ascontiguousarray(backward), np.ascontiguousarray(correction)
    field = np.empty_like(backward)
    correct(backward, correction, low, high, 0, FIELD_SIZE, field)
    return field


def box_between(first: Voxel, end: Voxel) -> Box:
    """The box of voxels from one to before another, in edges of the grid."""
    (x0, y0, z0), (x1, y1, z1) = first, end
    return (x0 / GRID_SIZE, y0 / GRID_SIZE, z0 / GRID_SIZE), (x1 / GRID_SIZE, y1 / GRID_SIZE, z1 / GRID_SIZE)


def corners(body: Box | None, correction: Lattice) -> tuple[Vector, Vector]:
    """Lowest and highest place that material is corrected at, see `corrected`.

    They are those of the box, and around it what the correction inside can amount to: far from the body there is no
    bound to it.
    """
    if body is None:
        return _NOWHERE, _EVERYWHERE
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


@compiled
def correct(
    backward: Field, correction: Lattice, low: Vector, high: Vector, first: int, end: int, result: Field
) -> None:
    """`corrected` at the nodes, of some along x, whose material the field says to come from between two corners.

    Those of a row along z are gathered first, so that the arithmetic of eight is done at once. A node is written once:
    another thread may look up what it writes there, too.
    """
    size, columns = correction.shape[1], FIELD_SIZE * FIELD_SIZE
    fields, lattice = backward.reshape(3, columns * FIELD_SIZE), correction.reshape(3, size * size * size)
    place, moved, u, final = _row(), _row(), _row(), _row()
    node, cells = np.empty(FIELD_SIZE, np.int32), np.empty(FIELD_SIZE, np.int32)
    shares = np.empty((5, FIELD_SIZE), np.float32)
    for i in range(first, end):
        for j in range(FIELD_SIZE):
            x, y, before, count = STEPS[i], STEPS[j], (i * FIELD_SIZE + j) * FIELD_SIZE, 0
            for k in range(FIELD_SIZE):
                ux, uy, uz = fields[0, before + k], fields[1, before + k], fields[2, before + k]
                final[0, k], final[1, k], final[2, k] = ux, uy, uz
                at_x, at_y, at_z = x - ux, y - uy, STEPS[k] - uz
                outside = (at_x < low[0]) | (at_x > high[0]) | (at_y < low[1]) | (at_y > high[1])
                outside |= (at_z < low[2]) | (at_z > high[2])
                node[count], place[0, count], place[1, count], place[2, count] = k, at_x, at_y, at_z
                count += int(not outside)
            _find_cells(place, size, count, cells, shares)
            _interpolate(lattice, size, cells, shares, count, moved)
            for n in range(count):
                mx, my, mz, height = moved[0, n], moved[1, n], moved[2, n], max(place[2, n], _ZERO)
                squared = mx * mx + my * my + mz * mz
                held = height / np.sqrt(squared) if squared > height * height else _ONE
                moved[0, n], moved[1, n], moved[2, n] = held * mx, held * my, held * mz
                place[0, n], place[1, n], place[2, n] = x - moved[0, n], y - moved[1, n], STEPS[node[n]] - moved[2, n]
            _find_cells(place, FIELD_SIZE, count, cells, shares)
            _interpolate(fields, FIELD_SIZE, cells, shares, count, u)
            for n in range(count):
                for axis in range(3):
                    u[axis, n] += moved[axis, n]
            for n in range(count):
                at = np.uintp(node[n])
                final[0, at], final[1, at], final[2, at] = u[0, n], u[1, n], u[2, n]
            for axis in range(3):
                for k in range(FIELD_SIZE):
                    result[axis, i, j, k] = final[axis, k]


@compiled
def _row() -> Row:
    """Room for a vector at every node of a row."""
    return np.empty((3, FIELD_SIZE), np.float32)


@compiled
def _find_cells(place: Row, size: int, count: int, cells: Int32[np.ndarray, " n"], shares: Shares) -> None:
    """The cells of a lattice that places in edges of the grid lie in: the number of each one's lowest node.

    The shares are those of its four edges along z and of their upper ends.
    """
    per_edge, last, nodes, lowest = np.float32(size), np.float32(size - 1), np.int32(size), np.int32(size - 2)
    for n in range(count):
        a, b, c = place[0, n] * per_edge - _HALF, place[1, n] * per_edge - _HALF, place[2, n] * per_edge - _HALF
        # nor is below zero what is no number
        a, b, c = (a if a > _ZERO else _ZERO), (b if b > _ZERO else _ZERO), (c if c > _ZERO else _ZERO)
        a, b, c = (a if a < last else last), (b if b < last else last), (c if c < last else last)
        i, j, k = min(np.int32(a), lowest), min(np.int32(b), lowest), min(np.int32(c), lowest)
        cells[n] = np.int32(np.int32(i * nodes + j) * nodes + k)
        a, b = a - np.float32(i), b - np.float32(j)
        shares[0, n], shares[1, n] = (_ONE - a) * (_ONE - b), (_ONE - a) * b
        shares[2, n], shares[3, n], shares[4, n] = a * (_ONE - b), a * b, c - np.float32(k)


@compiled
def _interpolate(
    lattice: Float32[np.ndarray, "3 nodes"], size: int, cells: Int32[np.ndarray, " n"], shares: Shares, count: int,
    result: Row,
) -> None:  # fmt: skip
    """Trilinear in the cells that `_find_cells` found."""
    # an index without a sign is not looked at for counting from the end
    along_y, along_x = np.uintp(size), np.uintp(size * size)
    for n in range(count):
        cell, p, q, r, s, c = np.uintp(cells[n]), shares[0, n], shares[1, n], shares[2, n], shares[3, n], shares[4, n]
        for axis in range(3):
            values = lattice[axis]
            low = (p * values[cell] + q * values[cell + along_y]) + (
                r * values[cell + along_x] + s * values[cell + along_x + along_y]
            )
            high = (p * values[cell + _NEXT] + q * values[cell + along_y + _NEXT]) + (
                r * values[cell + along_x + _NEXT] + s * values[cell + along_x + along_y + _NEXT]
            )
            result[axis, n] = low + c * (high - low)
