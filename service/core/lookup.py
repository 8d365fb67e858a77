"""A body looked up where a displacement field says that it came from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Bool, Float32, UInt8

from service.core.arrays import GRID_SIZE, Occupancy, Probability
from service.core.columns import fill_column, fill_slab, scratch
from service.core.compiled import compiled
from service.core.displacement import Box, Field, Lattice, Vector, box_between, corners, correct
from service.core.extent import Voxel, filled_range
from service.core.reach import CELLS, cells_of, nodes_of, tell_tops
from service.core.smoothing import smoothed, sure_of
from service.core.spread import Spread, in_turn

EVEN = 0.48
"""Value that stays as it is: which voxels are in the body does not depend on how sure that is."""

DOUBT, DOUBT_OF_MOTION = 0.09, 3.6
"""By how much a smoothed occupancy is to be doubted: where nothing moves, and what each edge of the grid that the
material has come adds to it, in squares, as the error of an answer grows with it. The likeliest on the validation
samples of `everyday`; docs/runs.md tells what they give."""

Values: TypeAlias = Float32[np.ndarray, "x y z"]
Flat: TypeAlias = Float32[np.ndarray, " voxels"]
Kinds: TypeAlias = UInt8[np.ndarray, " voxels"]


@dataclass(frozen=True, eq=False)
class Inside:
    """How much of each voxel is in the body, where that is known better than from the voxels that are.

    Attributes:
        values: Above one half about where the body is.
        probable: Whether they are probabilities, as of a reconstruction; else they tell where between the voxels the
            surface of a known body passes, see `smoothed`.
    """

    values: Probability
    probable: bool


class _Known(NamedTuple):
    """What the body is looked up in: the box of its voxels and one more on each side, and two of zeros around these.

    Attributes:
        sole: Lowest voxels of the body in the whole grid.
        values: The voxels, in C order.
        kinds: Of the eight values from each on, whether they are all 0, all 1 or neither.
        shape: Of `values`.
        low, high: The box, without the zeros.
        probable: See `Inside`.
    """

    sole: Bool[np.ndarray, "x=64 y=64"]
    values: Flat
    kinds: Kinds
    shape: Voxel
    low: Voxel
    high: Voxel
    probable: bool


def warp(rest: Occupancy, field: Field) -> Probability:
    """Occupancy of the deformed body: the undeformed one, looked up at y - u(y).

    Args:
        rest: Undeformed body.
        field: Backward displacement in edges of the grid; at the voxels it is that of `motion`.

    Returns:
        1 inside, 0 outside, in between within a voxel of the surface, see `smoothed` and `DOUBT`; where nothing moves,
        above one half exactly in the body.
    """
    return Warp(rest)(field)


class Warp:
    """`warp` of one body, ready for any number of fields.

    Args:
        rest: The body.
        inside: How much of each voxel is in it; None smooths the voxels.

    Attributes:
        body: Box of the body in edges of the grid; None if it is empty.
    """

    def __init__(self, rest: Occupancy, inside: Inside | None = None) -> None:
        filled = filled_range(rest)
        self._known: _Known | None = None
        self.body: Box | None = None
        if filled is not None:
            self.body = box_between(*filled)
            # The voxels between the outermost filled ones, and one more on each side where the grid has one.
            (x, y, z), (end_x, end_y, end_z) = filled
            low = (max(x - 1, 0), max(y - 1, 0), max(z - 1, 0))
            high = (min(end_x + 1, GRID_SIZE), min(end_y + 1, GRID_SIZE), min(end_z + 1, GRID_SIZE))
            part = tuple(slice(*ends) for ends in zip(low, high, strict=True))
            values = smoothed(rest[part]) if inside is None else sure_of(rest[part], inside.values[part])
            # Two voxels of zeros on every side stand for everything outside.
            around = np.zeros([size + 4 for size in values.shape], np.float32)
            around[2:-2, 2:-2, 2:-2] = values
            kinds = np.zeros(around.shape, np.uint8)
            _tell_kinds(around, kinds)
            sole, (sx, sy, sz) = np.ascontiguousarray(rest[:, :, 0]), around.shape
            probable = inside is not None and inside.probable
            self._known = _Known(sole, around.ravel(), kinds.ravel(), (sx, sy, sz), low, high, probable)

    def __call__(self, field: Field) -> Probability:
        """Occupancy after one load.

        Args:
            field: See `warp`.
        """
        probability = np.zeros((GRID_SIZE,) * 3, np.float32)
        if self._known is not None:
            _look_up(np.ascontiguousarray(field), self._known, 0, GRID_SIZE, probability)
        return probability

    def corrected(
        self, backward: Field, correction: Lattice, field: Field, probability: Probability, spread: Spread = in_turn
    ) -> None:
        """The field of a load, corrected around the body, see `service.core.displacement`, and occupancy after it.

        Args:
            backward: Displacement in edges of the grid that lacks a correction.
            correction: What it lacks, on a lattice of its own.
            field: Is written over with the corrected field.
            probability: Is written over with the occupancy.
            spread: Over the voxels along x.
        """
        known, (low, high) = self._known, corners(self.body, correction)
        if known is None:
            field[...] = backward
            probability[...] = 0.0
            return
        backward, correction = np.ascontiguousarray(backward), np.ascontiguousarray(correction)
        spread(
            lambda first, end: _correct_and_look_up(
                backward, correction, low, high, known, first, end, field, probability
            ),
            GRID_SIZE,
        )


_ZERO, _ONE, _EIGHT = (np.float32(number) for number in (0.0, 1.0, 8.0))
_BELOW, _ABOVE = np.float32(EVEN), np.float32(1.0 - EVEN)
_STILL, _MOVED = np.float32((4.0 * DOUBT) ** 2), np.float32((4.0 * DOUBT_OF_MOTION) ** 2)
_NEXT = np.uintp(1)
"""An index without a sign is not looked at for counting from the end."""
_EMPTY, _MIXED, _FULL = (np.uint8(kind) for kind in range(3))
_VOXELS = np.float32(GRID_SIZE)


@compiled
def _correct_and_look_up(
    backward: Field, correction: Lattice, low: Vector, high: Vector, known: _Known, first_x: int, end_x: int,
    field: Field, probability: Probability,
) -> None:  # fmt: skip
    """Both for some voxels along x: the nodes on either side of them are corrected first.

    Two parts have nodes in common, which each of them corrects for itself, to the same bits.
    """
    first, end = nodes_of(first_x, end_x)
    correct(backward, correction, low, high, first, end, field)
    _look_up(field, known, first_x, end_x, probability)


@compiled
def _look_up(field: Field, known: _Known, first_x: int, end_x: int, probability: Probability) -> None:
    """Values at y - u(y) for the voxels y of some layers along x."""
    sole, values, kinds, shape, probable = known.sole, known.values, known.kinds, known.shape, known.probable
    corner = (known.low[0] - 2, known.low[1] - 2, known.low[2] - 2)  # the voxel of the first value
    tops = np.empty((CELLS, CELLS), np.int64)
    first_cell, end_cell = cells_of(first_x, end_x)
    tell_tops(field, known.low, known.high, first_cell, end_cell, tops)
    coarse, slab, u = scratch()
    share, cells = np.empty((3, GRID_SIZE), np.float32), np.empty(GRID_SIZE, np.int32)
    mixed = np.empty(GRID_SIZE + 1, np.int32)
    looked_up, moved = np.empty(GRID_SIZE, np.float32), np.empty(GRID_SIZE, np.float32)
    size_y, size_z = np.int32(shape[1]), np.int32(shape[2])
    last_x, last_y, last_z = np.float32(shape[0] - 2), np.float32(shape[1] - 2), np.float32(shape[2] - 2)
    for x in range(first_x, end_x):
        first, end, highest = GRID_SIZE, 0, 0
        for y in range(GRID_SIZE):
            for z in range(GRID_SIZE):
                probability[x, y, z] = _ZERO
            top = tops[(x + 1) // 2, (y + 1) // 2]
            if top > 0:
                first, end, highest = min(first, y), y + 1, max(highest, top)
        if end == 0:
            continue
        fill_slab(field, x, first, end, highest, coarse, slab)
        for y in range(first, end):
            top = tops[(x + 1) // 2, (y + 1) // 2]
            if top == 0:
                continue
            fill_column(slab, sole[x, y], y, top, u)
            for z in range(top):
                a = _held(np.float32(x - corner[0]) - _VOXELS * u[0, z], last_x)
                b = _held(np.float32(y - corner[1]) - _VOXELS * u[1, z], last_y)
                c = _held(np.float32(z - corner[2]) - _VOXELS * u[2, z], last_z)
                i, j, k = np.int32(a), np.int32(b), np.int32(c)
                cells[z] = (i * size_y + j) * size_z + k
                share[0, z], share[1, z], share[2, z] = a - np.float32(i), b - np.float32(j), c - np.float32(k)
            # gathered first: what is to be looked up comes and goes at the surface, where no processor foresees it
            count = 0
            for z in range(top):
                kind = kinds[np.uintp(cells[z])]
                probability[x, y, z] = _ONE if kind == _FULL else _ZERO
                mixed[count] = z
                count += int(kind == _MIXED)
            for n in range(count):
                at = np.uintp(mixed[n])
                cell = np.uintp(cells[at])
                looked_up[n] = between(values, cell, shape[1], shape[2], share[0, at], share[1, at], share[2, at])
                moved[n] = u[0, at] * u[0, at] + u[1, at] * u[1, at] + u[2, at] * u[2, at]
            if not probable:
                for n in range(count):
                    looked_up[n] = _probability(looked_up[n], moved[n])
            for n in range(count):
                probability[x, y, np.uintp(mixed[n])] = looked_up[n]


@compiled
def _probability(value: np.float32, moved: np.float32) -> np.float32:
    """Of a smoothed occupancy v where the material has come by u, `moved` = |u|².

    r = (v − e)/√((v − e)² + (4 v (1 − v))² (a² + b² |u|²)) tells from −1 to 1 how sure it is, e being `EVEN`, a and b
    the doubts; the probability is e + e r below e, e + (1 − e) r above.
    """
    beyond, slack = value - _BELOW, value * (_ONE - value)
    sure = beyond / np.sqrt(beyond * beyond + slack * slack * (_STILL + _MOVED * moved))
    probability = _BELOW + sure * (_ABOVE if beyond > _ZERO else _BELOW)
    return np.float32(min(max(probability, _ZERO), _ONE))


@compiled
def _held(place: np.float32, last: np.float32) -> np.float32:
    """From 0 to the last; what is no number is 0."""
    place = place if place > _ZERO else _ZERO
    return place if place < last else last


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
