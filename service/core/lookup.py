"""A body seen through the displacement field of a load: occupancy after it, and how far its voxels have moved."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float32, UInt8, UInt64

from service.core.arrays import GRID_SIZE, Occupancy, Probability
from service.core.compiled import compiled
from service.core.displacement import Field
from service.core.extent import Voxel, filled_range
from service.core.prior_field import FIELD_SIZE
from service.core.smoothing import smoothed, sure_of

Displacement: TypeAlias = Float32[np.ndarray, "axis=3 x=64 y=64 z=64"]
Range: TypeAlias = tuple[int, int]
"""First voxel along an axis, and the one after the last."""
Layer: TypeAlias = Bool[np.ndarray, "x=64 y=64"]
Eights: TypeAlias = UInt64[np.ndarray, "x=64 y=64 eighth=8"]
"""Eight voxels a number, which is 0 where none of them is filled."""
Values: TypeAlias = Float32[np.ndarray, "x y z"]

Flat: TypeAlias = Float32[np.ndarray, " voxels"]
Kinds: TypeAlias = UInt8[np.ndarray, " voxels"]


@dataclass(frozen=True, eq=False)
class Motion:
    """How a body's voxels have moved.

    Attributes:
        displacement_m: At each voxel of the deformed body the displacement, along the axes of the grid, of the
            material now there; zero outside the body.
        max_m, mean_m: Lengths over the deformed body.
    """

    displacement_m: Displacement
    max_m: float
    mean_m: float


def motion(field: Field, rest: Occupancy, deformed: Occupancy, edge_m: float) -> Motion:
    """The field at the voxels of the deformed body.

    Between its nodes it is trilinear, and beyond the outermost the last value holds. The lowest voxels of the body at
    rest do not move: they lie half a voxel above what is clamped.

    Args:
        field: Backward displacement in edges of the grid.
        rest: The body before the load.
        deformed: The body after it.
        edge_m: Edge of the grid in metres.
    """
    displacement_m = np.zeros((3, *(GRID_SIZE,) * 3), np.float32)
    sole = np.ascontiguousarray(rest[:, :, 0])
    largest_m, total_m = _gather(
        np.ascontiguousarray(field), sole, deformed, deformed.view(np.uint64), np.float32(edge_m), displacement_m
    )
    return Motion(displacement_m, largest_m, total_m / max(int(np.count_nonzero(deformed)), 1))


def warp(rest: Occupancy, field: Field) -> Probability:
    """Occupancy of the deformed body: the undeformed one, looked up at y - u(y).

    Args:
        rest: Undeformed body.
        field: Backward displacement in edges of the grid; at the voxels it is that of `motion`.

    Returns:
        1 inside, 0 outside, in between within a voxel of the surface, see `smoothed`; where nothing moves, above one
        half exactly in the body.
    """
    return Warp(rest)(field)


class Warp:
    """`warp` of one body, ready for any number of fields.

    Args:
        rest: The body.
        smooth: Its smoothed occupancy where that is known better than from its voxels.
    """

    def __init__(self, rest: Occupancy, smooth: Probability | None = None) -> None:
        self._sole = np.ascontiguousarray(rest[:, :, 0])
        filled = filled_range(rest)
        self._box = None
        if filled is not None:
            # The voxels between the outermost filled ones, and one more on each side where the grid has one.
            first, end = filled
            self._box = tuple((max(a - 1, 0), min(b + 1, GRID_SIZE)) for a, b in zip(first, end, strict=True))
            part = tuple(slice(*ends) for ends in self._box)
            values = smoothed(rest[part]) if smooth is None else sure_of(rest[part], smooth[part])
            # Two voxels of zeros on every side stand for everything outside.
            self._values = np.zeros([size + 4 for size in values.shape], np.float32)
            self._values[2:-2, 2:-2, 2:-2] = values
            self._kinds = np.zeros(self._values.shape, np.uint8)
            _tell_kinds(self._values, self._kinds)

    def __call__(self, field: Field) -> Probability:
        """Occupancy after one load."""
        probability = np.zeros((GRID_SIZE,) * 3, np.float32)
        if self._box is not None:
            # What is at y comes from the body only if y is one of its voxels, moved by some u there is.
            reached = [_reached(*ends, u) for ends, u in zip(self._box, field, strict=True)]
            (x, _), (y, _), (z, _) = self._box
            sx, sy, sz = self._values.shape
            _look_up(
                np.ascontiguousarray(field), self._sole, self._values.ravel(), self._kinds.ravel(), (sx, sy, sz),
                (x - 2, y - 2, z - 2), *_corners(reached), probability,
            )  # fmt: skip
        return probability


def _reached(first: int, end: int, displacement: Float32[np.ndarray, "x y z"]) -> Range:
    """Where along an axis voxels of the body may get to."""
    low, high = (GRID_SIZE * float(bound) for bound in (displacement.min(), displacement.max()))
    if not math.isfinite(high - low):
        return 0, GRID_SIZE
    # The values reach one voxel beyond the body's outermost centres.
    low, high = first + low - 1.0, end + high + 1.0
    return math.floor(min(max(low, 0.0), GRID_SIZE - 1.0)), math.ceil(min(max(high, 1.0), float(GRID_SIZE)))


def _corners(ranges: Sequence[Range]) -> tuple[Voxel, Voxel]:
    (x0, x1), (y0, y1), (z0, z1) = ranges
    return (x0, y0, z0), (x1, y1, z1)


_ZERO, _QUARTER, _THREE_QUARTERS, _ONE, _EIGHT = (np.float32(number) for number in (0.0, 0.25, 0.75, 1.0, 8.0))
_NEXT = np.uintp(1)
"""An index without a sign is not looked at for counting from the end."""
_EMPTY, _MIXED, _FULL = (np.uint8(kind) for kind in range(3))
_VOXELS = np.float32(GRID_SIZE)


@compiled
def _look_up(
    field: Field, sole: Layer, values: Flat, kinds: Kinds, shape: Voxel, corner: Voxel, first: Voxel, end: Voxel,
    probability: Probability,
) -> None:  # fmt: skip
    """Values at y - u(y) for the voxels y from `first` to before `end`; `corner` is the voxel of the first value."""
    coarse, slab, u = _scratch()
    cells = np.empty(GRID_SIZE, np.int32)
    size_y, size_z = np.int32(shape[1]), np.int32(shape[2])
    last_x, last_y, last_z = np.float32(shape[0] - 2), np.float32(shape[1] - 2), np.float32(shape[2] - 2)
    for x in range(first[0], end[0]):
        _fill_slab(field, x, first[1], end[1], end[2], coarse, slab)
        for y in range(first[1], end[1]):
            _fill_column(slab, sole[x, y], y, end[2], u)
            for z in range(end[2]):
                a = _held(np.float32(x - corner[0]) - _VOXELS * u[0, z], last_x)
                b = _held(np.float32(y - corner[1]) - _VOXELS * u[1, z], last_y)
                c = _held(np.float32(z - corner[2]) - _VOXELS * u[2, z], last_z)
                i, j, k = np.int32(a), np.int32(b), np.int32(c)
                cells[z] = (i * size_y + j) * size_z + k
                u[0, z], u[1, z], u[2, z] = a - np.float32(i), b - np.float32(j), c - np.float32(k)
            for z in range(first[2], end[2]):
                cell = np.uintp(cells[z])
                if kinds[cell] == _FULL:
                    probability[x, y, z] = _ONE
                elif kinds[cell] == _MIXED:
                    probability[x, y, z] = between(values, cell, shape[1], shape[2], u[0, z], u[1, z], u[2, z])


@compiled
def _held(place: np.float32, last: np.float32) -> np.float32:
    """From 0 to the last; what is no number is 0."""
    place = place if place > _ZERO else _ZERO
    return place if place < last else last


@compiled
def _gather(
    field: Field, sole: Layer, deformed: Occupancy, eights: Eights, edge_m: np.float32, displacement_m: Displacement
) -> tuple[float, float]:
    """`motion`: fills the displacement in, and returns the largest of its lengths and their sum."""
    coarse, slab, u = _scratch()
    # kept for every layer, so that what is done to a column is done to many voxels at once
    largest, total = np.zeros(GRID_SIZE, np.float32), np.zeros(GRID_SIZE, np.float32)
    for x in range(GRID_SIZE):
        first, end = GRID_SIZE, 0
        for y in range(GRID_SIZE):
            if _any(eights, x, y):
                first, end = min(first, y), y + 1
        if end == 0:
            continue
        _fill_slab(field, x, first, end, GRID_SIZE, coarse, slab)
        for y in range(first, end):
            if not _any(eights, x, y):
                continue
            _fill_column(slab, sole[x, y], y, GRID_SIZE, u)
            for z in range(GRID_SIZE):
                scale = edge_m if deformed[x, y, z] else _ZERO
                a, b, c = scale * u[0, z], scale * u[1, z], scale * u[2, z]
                displacement_m[0, x, y, z], displacement_m[1, x, y, z], displacement_m[2, x, y, z] = a, b, c
                u[0, z] = a * a + b * b + c * c
            for z in range(GRID_SIZE):
                length = np.sqrt(u[0, z])
                total[z] += length
                largest[z] = length if length > largest[z] else largest[z]
    return largest.max(), total.sum()


@compiled
def _any(eights: Eights, x: int, y: int) -> bool:
    """Whether a column holds a filled voxel."""
    found = np.uint64(0)
    for eight in range(GRID_SIZE // 8):
        found |= eights[x, y, eight]
    return bool(found != 0)


@compiled
def _scratch() -> tuple[Float32[np.ndarray, "32"], Float32[np.ndarray, "3 32 64"], Float32[np.ndarray, "3 64"]]:
    """Room for a row of nodes, for a slab of one x as `_fill_slab` fills it, and for one column of voxels."""
    return (
        np.empty(FIELD_SIZE, np.float32), np.empty((3, FIELD_SIZE, GRID_SIZE), np.float32),
        np.empty((3, GRID_SIZE), np.float32),
    )  # fmt: skip


@compiled
def _node_below(voxel: int) -> tuple[int, int, np.float32]:
    """The nodes on either side of a voxel, and what the upper one counts for: ¼ or ¾, as nodes are two voxels apart."""
    below = (voxel + 1) // 2 - 1
    return max(below, 0), min(below + 1, FIELD_SIZE - 1), _QUARTER if voxel % 2 else _THREE_QUARTERS


@compiled
def _fill_slab(
    field: Field, x: int, first: int, end: int, end_z: int, coarse: Float32[np.ndarray, "32"],
    slab: Float32[np.ndarray, "axis=3 node=32 z=64"],
) -> None:  # fmt: skip
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
def _fill_column(
    slab: Float32[np.ndarray, "axis=3 node=32 z=64"], clamped: bool, y: int, end: int,
    u: Float32[np.ndarray, "axis=3 z=64"],
) -> None:  # fmt: skip
    """The field at the voxels of one column below `end`; its lowest one does not move where it is clamped."""
    lower, upper, b = _node_below(y)
    for axis in range(3):
        for z in range(end):
            u[axis, z] = slab[axis, lower, z] + b * (slab[axis, upper, z] - slab[axis, lower, z])
        if clamped:
            u[axis, 0] = 0.0


@compiled
def _tell_kinds(values: Values, kinds: UInt8[np.ndarray, "x y z"]) -> None:
    """Whether the eight values around a place are all 0, all 1 or neither: to look is less work than to look up."""
    size_x, size_y, size_z = kinds.shape
    sums = np.empty(size_z, np.float32)
    for i in range(size_x - 1):
        for j in range(size_y - 1):
            for k in range(size_z):
                sums[k] = values[i, j, k] + values[i, j + 1, k] + values[i + 1, j, k] + values[i + 1, j + 1, k]
            for k in range(size_z - 1):
                eight = sums[k] + sums[k + 1]
                kinds[i, j, k] = _EMPTY if eight == _ZERO else _FULL if eight == _EIGHT else _MIXED


@compiled
def between(
    values: Flat, cell: np.uintp, size_y: int, size_z: int, a: np.float32, b: np.float32, c: np.float32
) -> np.float32:
    """Trilinear lookup in a field of size_y × size_z voxels across, its values in C order.

    `cell` is the place of the voxel that is below in all three axes, beside which there must be others; a, b and c are
    what the next one along x, y and z counts for, from 0 to 1.
    """
    next_x = cell + np.uintp(size_y) * np.uintp(size_z)
    next_y, next_xy = cell + np.uintp(size_z), next_x + np.uintp(size_z)
    p, q, r, s = values[cell], values[next_y], values[next_x], values[next_xy]
    p += c * (values[cell + _NEXT] - p)
    q += c * (values[next_y + _NEXT] - q)
    r += c * (values[next_x + _NEXT] - r)
    s += c * (values[next_xy + _NEXT] - s)
    p += b * (q - p)
    return np.float32(p + a * (r + b * (s - r) - p))
