"""A signed distance on a lattice near the surface: what it takes to ask for millions of points inside or outside.

A shape is a tree of a dozen functions, and asking it costs 0.1 to 0.3 µs a point. All questions of a body are about
points near its surface, so the tree is asked once on the nodes of a lattice there, and everything else interpolates.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, UInt8

from training.simulation.compiled import compiled
from training.simulation.surface import Distance

SUBSAMPLES = 4
"""Sample points along each edge of an octant that the surface may cross."""
OUTSIDE, INSIDE, NEAR = 0, 1, 2
"""States of an octant: wholly on one side, or perhaps crossed by the surface."""
SAMPLED_SHELL = 0.75
"""Half thickness, in octants, of the shell around the surface where the lattice has values: what loads integrate over,
`surface.SHELL` times a quarter of a cell."""
STRAIGHT_ERROR = 3.0
"""Doubts by which `straight` must differ from zero for `interpolated` to differ from it by more than one, on the same
side: nodes off by one move a quadratic by up to 1.25 along each axis, 1.25³ = 1.95 in all."""
_REACH = 1.25
"""How many times its half diagonal a cube's centre must lie away from the surface to be settled: a margin for functions
that are only nearly distances; ellipsoids overstate theirs by up to 17 %."""
_ROUNDING = 1e-6
"""Of values in float32."""


@dataclass(frozen=True, eq=False)
class SampledDistance:
    """A signed distance with the octants of a grid of cells sorted by it; calling it asks the function itself.

    Attributes:
        distance: The function.
        cells: Cells along each edge of the cube.
        state: `OUTSIDE`, `INSIDE` or `NEAR` of each of the (2·cells)³ octants.
        lattice: Values on the corners of the octants and half-way between, those within `SAMPLED_SHELL` of the surface;
            zero elsewhere.
        doubt: How far interpolation in such an octant may be off: the curvature that its own nodes show; else zero.
    """

    distance: Distance
    cells: int
    state: UInt8[np.ndarray, "n2 n2 n2"]
    lattice: Float32[np.ndarray, "n4 n4 n4"]
    doubt: Float32[np.ndarray, "n2 n2 n2"]

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
        values = lattice.ravel()[nodes]
        doubt = np.zeros(state.shape, np.float32)
        doubt[tuple(octants.T)] = np.abs(values - values @ _STRAIGHT).max(axis=1, initial=0.0) + _ROUNDING
        return cls(distance, cells, state, lattice, doubt)

    def __call__(self, points: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, " n"]:
        return self.distance(points)

    def inside(self, points: Float32[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Sign of the function itself at points of the cube; it is asked only where interpolation leaves a doubt."""
        side = _sides(points, self.state, self.lattice, self.doubt)
        asked = np.flatnonzero(side == NEAR)
        side[asked] = self.distance(points[asked]) < 0
        return np.asarray(side == INSIDE)

    @cached_property
    def octant_fill(self) -> Float64[np.ndarray, "n2 n2 n2"]:
        """Part of each octant that lies inside, as the mean over sample points."""
        fill = (self.state == INSIDE).astype(np.float64)
        octants = np.argwhere(self.state == NEAR)
        value = self.lattice.ravel()[_nodes(octants, 2 * self.cells)] @ _TO_SAMPLES
        row, sample = np.nonzero(np.abs(value) <= self.doubt[tuple(octants.T)][:, None])
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
def interpolated(
    lattice: Float32[np.ndarray, "n4 n4 n4"], i: int, j: int, k: int, x: float, y: float, z: float
) -> float:
    """Triquadratic value in octant (i, j, k) at local coordinates in [−1, 1]³.

    Source: Hughes, The Finite Element Method (2000), section 3.6, Lagrange elements.
    """
    p = (0.5 * x * (x - 1.0), 1.0 - x * x, 0.5 * x * (x + 1.0))
    q = (0.5 * y * (y - 1.0), 1.0 - y * y, 0.5 * y * (y + 1.0))
    r = (0.5 * z * (z - 1.0), 1.0 - z * z, 0.5 * z * (z + 1.0))
    i, j, k = 2 * i, 2 * j, 2 * k
    value = 0.0
    for a in range(3):
        for b in range(3):
            # whole indices, no views: a view would count its references, which takes longer than the sum
            line = r[0] * lattice[i + a, j + b, k] + r[1] * lattice[i + a, j + b, k + 1]
            value += p[a] * q[b] * (line + r[2] * lattice[i + a, j + b, k + 2])
    return value


@compiled
def straight(lattice: Float32[np.ndarray, "n4 n4 n4"], i: int, j: int, k: int, x: float, y: float, z: float) -> float:
    """As `interpolated`, trilinearly between the octant's corners: a third of the work."""
    i, j, k = 2 * i, 2 * j, 2 * k
    x, y, z = 0.5 * (x + 1.0), 0.5 * (y + 1.0), 0.5 * (z + 1.0)
    a = (1.0 - z) * lattice[i, j, k] + z * lattice[i, j, k + 2]
    b = (1.0 - z) * lattice[i, j + 2, k] + z * lattice[i, j + 2, k + 2]
    c = (1.0 - z) * lattice[i + 2, j, k] + z * lattice[i + 2, j, k + 2]
    d = (1.0 - z) * lattice[i + 2, j + 2, k] + z * lattice[i + 2, j + 2, k + 2]
    return float((1.0 - x) * ((1.0 - y) * a + y * b) + x * ((1.0 - y) * c + y * d))


@compiled
def _sides(
    points: Float32[np.ndarray, "n 3"],
    state: UInt8[np.ndarray, "n2 n2 n2"],
    lattice: Float32[np.ndarray, "n4 n4 n4"],
    doubt: Float32[np.ndarray, "n2 n2 n2"],
) -> UInt8[np.ndarray, " n"]:
    """`INSIDE`, `OUTSIDE`, or `NEAR` where the interpolated value is not above the doubt."""
    n = state.shape[0]
    sides = np.empty(len(points), np.uint8)
    for row in range(len(points)):
        x, y, z = points[row, 0] * n, points[row, 1] * n, points[row, 2] * n
        i, j, k = min(max(int(x), 0), n - 1), min(max(int(y), 0), n - 1), min(max(int(z), 0), n - 1)
        side = state[i, j, k]
        if side == 2:
            value = interpolated(lattice, i, j, k, 2.0 * (x - i) - 1.0, 2.0 * (y - j) - 1.0, 2.0 * (z - k) - 1.0)
            if abs(value) > doubt[i, j, k]:
                side = 1 if value < 0.0 else 0
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


def _weights(local: Float64[np.ndarray, "n 3"], quadratic: bool) -> Float32[np.ndarray, "27 n"]:
    """Weight of each of an octant's 27 nodes at local coordinates in [−1, 1]³; the linear ones use its corners only."""
    if quadratic:
        factor = np.stack([0.5 * local * (local - 1), 1 - local**2, 0.5 * local * (local + 1)])
    else:
        factor = np.stack([0.5 * (1 - local), 0 * local, 0.5 * (1 + local)])
    weights = factor[:, None, None, :, 0] * factor[None, :, None, :, 1] * factor[None, None, :, :, 2]
    return np.asarray(weights.reshape(27, -1), np.float32)


_TO_SAMPLES = _weights((_cube(SUBSAMPLES) + 0.5) / SUBSAMPLES * 2 - 1, True)
_STRAIGHT = _weights(_cube(3) - 1.0, False)
