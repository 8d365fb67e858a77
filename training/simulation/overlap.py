"""How much of its place at rest a body still fills when its linear displacement is scaled, without voxelising it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int, Int32, UInt8

from service.core.compiled import compiled
from training.simulation.body import Body
from training.simulation.elements import CORNERS
from training.simulation.sampled import INSIDE, NEAR, OUTSIDE, SampledDistance, interpolated, plain_side
from training.simulation.trilinear import nodal_coefficients, value_at

_SEED = 0
"""Of the places within the octants: the same for every body, so that a set does not depend on who draws it."""


@dataclass(frozen=True, eq=False)
class RestOverlap:
    """Material points of a body, one drawn within each octant, and what tells whether a place was filled at rest.

    With y(X) = X + u(X) and J = det ∂y/∂X, the body at rest B and its deformed volume y(B):
    |B ∩ y(B)| = ∫_B [y(X) ∈ B] J dX and |y(B)| = ∫_B J dX. Both integrals are sums over the points, so that a look
    costs a displacement and a question for each of them; no map is inverted. J is taken at the middle of each cell.

    Attributes:
        body: The body.
        place: Material points, in units of L; each stands for the volume of an octant.
        cell: Active cell of each, ascending.
        local: Where in its cell, from the middle, in its edges.
        sampled: Its distance, on the body's cells.

    Source: change of variables; one point in each stratum: Owen, Monte Carlo theory, methods and examples (2013), 10.1.
    """

    body: Body
    place: Float64[np.ndarray, "n 3"]
    cell: Int[np.ndarray, " n"]
    local: Float64[np.ndarray, "n 3"]
    sampled: SampledDistance

    @classmethod
    def of(cls, body: Body) -> RestOverlap:
        """Draw a point in each octant of the body's cells and keep those inside."""
        sampled = SampledDistance.on(body.distance, body.cells)
        cell, octant = np.nonzero(body.octant_fill.T > 0.0)
        inner = np.random.default_rng(_SEED).random((len(cell), 3))
        local = 0.5 * (CORNERS[octant] + inner)
        place = (body.active[cell] + local) / body.cells
        held = sampled.inside(place.astype(np.float32))
        return cls(body, place[held], cell[held], local[held] - 0.5, sampled)

    def along(self, displacement: Float64[np.ndarray, "nodes 3"]) -> OverlapAlong:
        """The overlap under all multiples of nodal displacements."""
        moved = np.empty_like(self.place)
        invariants = np.empty((len(self.body.active), 3))
        _follow(displacement, self.body.cell_nodes, self.body.cells, self.cell, self.local, moved, invariants)
        return OverlapAlong(self, moved, invariants)


@dataclass(frozen=True, eq=False)
class OverlapAlong:
    """The overlap of a body with itself at rest along one direction of displacement.

    Attributes:
        overlap: The body's points.
        moved: Their displacements.
        invariants: Of the displacement gradient G in the middle of each cell, those of det(1 + s G) = 1 + a s + b s² +
            c s³: trace, sum of the principal minors, determinant.
    """

    overlap: RestOverlap
    moved: Float64[np.ndarray, "n 3"]
    invariants: Float64[np.ndarray, "m 3"]

    def iou(self, factor: float, every: int = 1) -> float:
        """IoU of the body with itself at rest when the displacement is scaled, in [0, 1], by every such point of it.

        What leaves the cube counts for nothing, nor do cells that are turned inside out, as in voxels.
        """
        points = self.overlap
        kept, volume = _volumes(
            factor, every, points.place, self.moved, points.cell, self.invariants, points.sampled.state,
            points.sampled.number, points.sampled.polynomial, points.sampled.plane,
        )  # fmt: skip
        union = -(-len(points.place) // every) + volume - kept
        return kept / union if union > 0.0 else 1.0


@compiled
def _follow(
    nodal: Float64[np.ndarray, "nodes 3"],
    cell_nodes: Int[np.ndarray, "m 8"],
    cells: int,
    cell: Int[np.ndarray, " n"],
    local: Float64[np.ndarray, "n 3"],
    moved: Float64[np.ndarray, "n 3"],
    invariants: Float64[np.ndarray, "m 3"],
) -> None:
    """Write the displacement at every point, and the invariants of its gradient in the middle of every cell."""
    row = 0
    for m in range(len(cell_nodes)):
        p = nodal_coefficients(nodal, cell_nodes, m, 0)
        q = nodal_coefficients(nodal, cell_nodes, m, 1)
        r = nodal_coefficients(nodal, cell_nodes, m, 2)
        # the linear terms are the gradient in the middle, in edges of a cell
        a, b, c = cells * p[1], cells * p[2], cells * p[3]
        d, e, f = cells * q[1], cells * q[2], cells * q[3]
        g, h, k = cells * r[1], cells * r[2], cells * r[3]
        invariants[m, 0] = a + e + k
        invariants[m, 1] = (e * k - f * h) + (a * k - c * g) + (a * e - b * d)
        invariants[m, 2] = a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g)
        while row < len(cell) and cell[row] == m:
            x, y, z = local[row, 0], local[row, 1], local[row, 2]
            moved[row, 0], moved[row, 1] = value_at(p, x, y, z), value_at(q, x, y, z)
            moved[row, 2] = value_at(r, x, y, z)
            row += 1


@compiled
def _volumes(
    factor: float,
    every: int,
    place: Float64[np.ndarray, "n 3"],
    moved: Float64[np.ndarray, "n 3"],
    cell: Int[np.ndarray, " n"],
    invariants: Float64[np.ndarray, "m 3"],
    state: UInt8[np.ndarray, "n2 n2 n2"],
    number: Int32[np.ndarray, "n2 n2 n2"],
    polynomial: Float32[np.ndarray, "k 27"],
    plane: Float32[np.ndarray, "k 5"],
) -> tuple[float, float]:
    """Volume of the deformed body that was filled at rest, and all of it within the cube, in octants."""
    n = state.shape[0]
    kept, volume, present, ratio = 0.0, 0.0, -1, 1.0
    for row in range(0, len(place), every):
        if cell[row] != present:
            m = present = cell[row]
            ratio = 1.0 + factor * (invariants[m, 0] + factor * (invariants[m, 1] + factor * invariants[m, 2]))
        x = (place[row, 0] + factor * moved[row, 0]) * n
        y = (place[row, 1] + factor * moved[row, 1]) * n
        z = (place[row, 2] + factor * moved[row, 2]) * n
        if not (ratio > 0.0 and min(x, y, z) >= 0.0 and max(x, y, z) < n):
            continue
        volume += ratio
        i, j, k = int(x), int(y), int(z)
        side = int(state[i, j, k])
        if side == NEAR:
            octant, x, y, z = number[i, j, k], 2 * (x - i) - 1, 2 * (y - j) - 1, 2 * (z - k) - 1
            side = plain_side(plane, octant, x, y, z)
            # along sharp edges, where this rounds, a thousandth of a body goes astray
            if side == NEAR:
                side = INSIDE if interpolated(polynomial, octant, x, y, z) < 0.0 else OUTSIDE
        if side == INSIDE:
            kept += ratio
    return kept, volume
