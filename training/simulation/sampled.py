"""A signed distance on a lattice near the surface: what it takes to ask for millions of points inside or outside.

A shape is a tree of a dozen functions, and asking it costs 0.1 to 0.3 µs a point. All questions of a body are about
points near its surface, so the tree is asked once on the nodes of a lattice there, and everything else interpolates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, Int32, UInt8

from service.core.compiled import compiled
from training.simulation.surface import Distance

SUBSAMPLES = 4
"""Sample points along each edge of an octant that the surface may cross."""
OUTSIDE, INSIDE, NEAR = 0, 1, 2
"""States of an octant: wholly on one side, or perhaps crossed by the surface."""
EMPTY, WHOLE = -1, -2
"""Stand for these states where others have the row of their octant."""
SAMPLED_SHELL = 0.75
"""Half thickness, in octants, of the shell around the surface where the lattice has values: what loads integrate over,
`surface.SHELL` times a quarter of a cell."""
_SETTLED = 3.0
"""Doubts by which the corners of an octant must all lie on one side for interpolation to do so everywhere by one doubt:
nodes off by one move a quadratic by up to 1.25 along each axis, 1.25³ = 1.95 in all."""
_REACH = 1.25
"""How many times its half diagonal a cube's centre must lie away from the surface to be settled: a margin for functions
that are only nearly distances; ellipsoids overstate theirs by up to 17 %."""
_ROUNDING = 1e-6
"""Of values in float32."""
_PLANE = [0, 9, 3, 1]
"""Columns of 1, x, y, z among the 27 coefficients."""
_BEYOND = 1.05
"""Room for local coordinates that lie beyond [−1, 1] by what an inverse map is solved to."""


@dataclass(frozen=True, eq=False)
class SampledDistance:
    """A signed distance with the octants of a grid of cells sorted by it; calling it asks the function itself.

    Attributes:
        distance: The function.
        cells: Cells along each edge of the cube.
        state: `OUTSIDE`, `INSIDE` or `NEAR` of each of the (2·cells)³ octants.
        number: Row of each octant within `SAMPLED_SHELL` of the surface in the tables below; else −1.
        polynomial: Coefficients 9·a + 3·b + c of xᵃ yᵇ zᶜ, each power up to 2, in the octant's local coordinates in
            [−1, 1]³: the quadratics through the values on its corners and half-way between.
        doubt: How far interpolation may be off: the curvature that the octant's own nodes show.
        plane: Coefficients of 1, x, y, z, and the most that all other terms and the doubt may add anywhere in it.
    """

    distance: Distance
    cells: int
    state: UInt8[np.ndarray, "n2 n2 n2"]
    number: Int32[np.ndarray, "n2 n2 n2"]
    polynomial: Float32[np.ndarray, "k 27"]
    doubt: Float32[np.ndarray, " k"]
    plane: Float32[np.ndarray, "k 5"]

    @classmethod
    def of(cls, distance: Distance, cells: int) -> SampledDistance:
        """Sample a distance: cells first, then the octants of cells near the surface, then the nodes of those near."""
        n = 2 * cells
        whole = np.argwhere(np.ones((cells,) * 3, bool))
        value = distance(_centres(whole, cells))
        near = np.abs(value) < _REACH * (0.5 * np.sqrt(3.0) + 0.5 * SAMPLED_SHELL) / cells
        state = np.where(value < 0, INSIDE, OUTSIDE).astype(np.uint8).reshape((cells,) * 3)
        state = state.repeat(2, axis=0).repeat(2, axis=1).repeat(2, axis=2)
        octants = (2 * whole[near, None] + _cube(2)).reshape(-1, 3)
        value = distance(_centres(octants, n))
        crossed = np.abs(value) < _REACH * 0.5 * np.sqrt(3.0) / n
        state[tuple(octants.T)] = np.where(crossed, NEAR, np.where(value < 0, INSIDE, OUTSIDE))
        octants = octants[np.abs(value) < _REACH * (0.5 * np.sqrt(3.0) + SAMPLED_SHELL) / n]
        lattice = np.zeros((2 * n + 1,) * 3, np.float32)
        nodes = _nodes(octants, n)
        wanted = np.zeros(lattice.size, bool)
        wanted[nodes] = True
        index = np.flatnonzero(wanted)
        place = np.stack(np.unravel_index(index, lattice.shape), axis=1).astype(np.float32) / np.float32(2 * n)
        lattice.ravel()[index] = distance(place)
        # nodes first: what goes over the nodes of an octant then runs along many octants
        values = lattice.ravel()[np.ascontiguousarray(nodes.T)]
        doubt = np.abs(_BENT.T @ values).max(axis=0, initial=0.0) + np.float32(_ROUNDING)
        # where all corners lie on one side by enough, interpolation would give every point the same answer
        corners = values[_CORNERS]
        outside = corners.min(axis=0, initial=np.inf) > _SETTLED * doubt
        inside = corners.max(axis=0, initial=-np.inf) < -_SETTLED * doubt
        state[tuple(octants[outside].T)], state[tuple(octants[inside].T)] = OUTSIDE, INSIDE
        number = np.full(state.shape, -1, np.int32)
        number[tuple(octants.T)] = np.arange(len(octants), dtype=np.int32)
        polynomial = values.T @ _TO_POLYNOMIAL
        plane = np.empty((len(octants), 5), np.float32)
        plane[:, :4] = polynomial[:, _PLANE]
        plane[:, 4] = np.abs(polynomial) @ _ALL_BUT_THE_PLANE + doubt
        return cls(distance, cells, state, number, polynomial, doubt, plane)

    @classmethod
    def on(cls, distance: Distance, cells: int) -> SampledDistance:
        """A distance that is sampled on these cells already, or a new one."""
        return distance if isinstance(distance, cls) and distance.cells == cells else cls.of(distance, cells)

    def __call__(self, points: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, " n"]:
        return self.distance(points)

    def inside(self, points: Float32[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Sign of the function itself at points of the cube; it is asked only where interpolation leaves a doubt."""
        side = _sides(points, self.state, self.number, self.polynomial, self.doubt, self.plane)
        asked = np.flatnonzero(side == NEAR)
        side[asked] = self.distance(points[asked]) < 0
        return np.asarray(side == INSIDE)

    def octants_of(self, active: Int[np.ndarray, "m 3"]) -> Int32[np.ndarray, "m 8"]:
        """Row of each octant 4·dx + 2·dy + dz of some cells where it is `NEAR`, else `EMPTY` or `WHOLE`."""
        place = tuple(np.moveaxis(2 * active[:, None] + _cube(2), -1, 0))
        state, number = self.state[place], self.number[place]
        return np.where(state == NEAR, number, np.where(state == INSIDE, WHOLE, EMPTY)).astype(np.int32)

    @cached_property
    def octant_fill(self) -> Float64[np.ndarray, "n2 n2 n2"]:
        """Part of each octant that lies inside, as the mean over sample points."""
        fill = (self.state == INSIDE).astype(np.float64)
        octants = np.argwhere(self.state == NEAR)
        number = self.number[tuple(octants.T)]
        value = self.polynomial[number] @ _MONOMIALS_AT_SAMPLES
        row, sample = np.nonzero(np.abs(value) <= self.doubt[number][:, None])
        place = (octants[row] + (_cube(SUBSAMPLES)[sample] + 0.5) / SUBSAMPLES) / (2 * self.cells)
        value[row, sample] = self.distance(place.astype(np.float32))
        # a sample's share by its distance, not its side: counting is off by up to half a sample, which changes a member
        # four cells thick by 3 % and its bending stiffness by 12 %
        # a hair steeper than the width of a sample, so that rounding leaves whole samples whole
        share = np.clip(0.5 - 1.0001 * value * (2 * self.cells * SUBSAMPLES), 0.0, 1.0)
        fill[tuple(octants.T)] = share.mean(axis=1)
        return np.asarray(fill)


def octant_fill(distance: Distance, cells: int) -> Float64[np.ndarray, "n2 n2 n2"]:
    """Part of each of the (2·cells)³ octants that lies inside, as the mean over sample points."""
    return SampledDistance.of(distance, cells).octant_fill


@compiled
def interpolated(polynomial: Float32[np.ndarray, "k 27"], row: int, x: float, y: float, z: float) -> float:
    """Triquadratic value in the octant of a row of the table at local coordinates in [−1, 1]³, by Horner's rule.

    Source: Hughes, The Finite Element Method (2000), section 3.6, Lagrange elements.
    """
    # in single precision, as the values are: no conversions
    u, v, w = np.float32(x), np.float32(y), np.float32(z)
    value = np.float32(0.0)
    for a in range(2, -1, -1):
        line = np.float32(0.0)
        for b in range(2, -1, -1):
            # whole indices, no views: a view would count its references, which takes longer than the sum
            n = 9 * a + 3 * b
            line = line * v + (polynomial[row, n] + w * (polynomial[row, n + 1] + w * polynomial[row, n + 2]))
        value = value * u + line
    return float(value)


@compiled
def plain_side(plane: Float32[np.ndarray, "k 5"], row: int, x: float, y: float, z: float) -> int:
    """Side of a point that the plane of its octant alone can tell, at a tenth of the work; `NEAR` where it cannot."""
    value = plane[row, 0] + (
        np.float32(x) * plane[row, 1] + np.float32(y) * plane[row, 2] + np.float32(z) * plane[row, 3]
    )
    if value > plane[row, 4]:
        return OUTSIDE
    return INSIDE if value < -plane[row, 4] else NEAR


@compiled
def _sides(
    points: Float32[np.ndarray, "n 3"],
    state: UInt8[np.ndarray, "n2 n2 n2"],
    number: Int32[np.ndarray, "n2 n2 n2"],
    polynomial: Float32[np.ndarray, "k 27"],
    doubt: Float32[np.ndarray, " k"],
    plane: Float32[np.ndarray, "k 5"],
) -> UInt8[np.ndarray, " n"]:
    """`INSIDE`, `OUTSIDE`, or `NEAR` where the interpolated value is not above the doubt."""
    n = state.shape[0]
    sides = np.empty(len(points), np.uint8)
    for row in range(len(points)):
        x, y, z = points[row, 0] * n, points[row, 1] * n, points[row, 2] * n
        i, j, k = min(max(int(x), 0), n - 1), min(max(int(y), 0), n - 1), min(max(int(z), 0), n - 1)
        side = int(state[i, j, k])
        if side == NEAR:
            m = number[i, j, k]
            u, v, w = 2.0 * (x - i) - 1.0, 2.0 * (y - j) - 1.0, 2.0 * (z - k) - 1.0
            side = plain_side(plane, m, u, v, w)
            if side == NEAR:
                value = interpolated(polynomial, m, u, v, w)
                if abs(value) > doubt[m]:
                    side = INSIDE if value < 0.0 else OUTSIDE
        sides[row] = side
    return sides


def _cube(edge: int) -> Int[np.ndarray, "n 3"]:
    """Index (i, j, k) of every element of a cube, C order."""
    return np.argwhere(np.ones((edge,) * 3, bool))


def _nodes(octants: Int[np.ndarray, "n 3"], edge: int) -> Int[np.ndarray, "n 27"]:
    """Place of each octant's 27 nodes in the flat lattice over edge³ octants."""
    shape = (2 * edge + 1,) * 3
    first = np.ravel_multi_index(tuple(2 * octants.T), shape)
    return np.asarray(first[:, None] + np.ravel_multi_index(tuple(_cube(3).T), shape))


def _centres(index: Int[np.ndarray, "n 3"], edge: int) -> Float32[np.ndarray, "n 3"]:
    return ((index + 0.5) / edge).astype(np.float32)


def _cubed(table: Float64[np.ndarray, "m n"]) -> Float32[np.ndarray, "m3 n3"]:
    """What a table along one axis is along all three."""
    return np.kron(np.kron(table, table), table).astype(np.float32)


_TO_POLYNOMIAL = _cubed(np.array([[0.0, -0.5, 0.5], [1.0, 0.0, -1.0], [0.0, 0.5, 0.5]]))
_MONOMIALS_AT_SAMPLES = _cubed(((2.0 * np.arange(SUBSAMPLES) + 1.0) / SUBSAMPLES - 1.0)[None] ** np.arange(3)[:, None])
_STRAIGHT = _cubed(np.array([[1.0, 0.5, 0.0], [0.0, 0.0, 0.0], [0.0, 0.5, 1.0]]))
"""From an octant's 27 values to those of the trilinear function between its corners."""
_BENT = (np.eye(27, dtype=np.float32) - _STRAIGHT)[:, (_cube(3) == 1).any(axis=1)]
"""From its values to how far those off the corners are from that function."""
_ALL_BUT_THE_PLANE = np.where(np.isin(np.arange(27), _PLANE), 0.0, _BEYOND).astype(np.float32)
_CORNERS = np.flatnonzero((_cube(3) != 1).all(axis=1))
