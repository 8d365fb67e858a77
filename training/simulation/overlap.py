"""How much of its place at rest a body still fills when its linear displacement is scaled, without voxelising it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64, Int, Int32, UInt8

from service.core.compiled import compiled
from training.simulation.body import Body
from training.simulation.elements import CORNERS
from training.simulation.sampled import INSIDE, NEAR, OUTSIDE, SampledDistance, interpolated, plain_side

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
        cell: Active cell of each.
        sampled: Its distance, on the body's cells.

    Source: change of variables; one point in each stratum: Owen, Monte Carlo theory, methods and examples (2013), 10.1.
    """

    body: Body
    place: Float64[np.ndarray, "n 3"]
    cell: Int[np.ndarray, " n"]
    sampled: SampledDistance

    @classmethod
    def of(cls, body: Body) -> RestOverlap:
        """Draw a point in each octant of the body's cells and keep those inside."""
        sampled = SampledDistance.on(body.distance, body.cells)
        cell, octant = np.nonzero(body.octant_fill.T > 0.0)
        inner = np.random.default_rng(_SEED).random((len(cell), 3))
        place = (2.0 * body.active[cell] + CORNERS[octant] + inner) / (2 * body.cells)
        held = sampled.inside(place.astype(np.float32))
        return cls(body, place[held], cell[held], sampled)

    def along(self, displacement: Float64[np.ndarray, "nodes 3"]) -> OverlapAlong:
        """The overlap under all multiples of nodal displacements."""
        moved = np.empty_like(self.place)
        invariants = np.empty((len(self.body.active), 3))
        _follow(displacement, self.body.cell_nodes, self.body.active, self.body.cells, self.place, self.cell, moved,
                invariants)  # fmt: skip
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

    def iou(self, factor: float) -> float:
        """IoU of the body with itself at rest when the displacement is scaled, in [0, 1].

        What leaves the cube counts for nothing, nor do cells that are turned inside out, as in voxels.
        """
        points = self.overlap
        kept, volume = _volumes(
            factor, points.place, self.moved, points.cell, self.invariants, points.sampled.state,
            points.sampled.number, points.sampled.polynomial, points.sampled.plane,
        )  # fmt: skip
        union = len(points.place) + volume - kept
        return kept / union if union > 0.0 else 1.0


@compiled
def _follow(
    nodal: Float64[np.ndarray, "nodes 3"],
    cell_nodes: Int[np.ndarray, "m 8"],
    active: Int[np.ndarray, "m 3"],
    cells: int,
    place: Float64[np.ndarray, "n 3"],
    cell: Int[np.ndarray, " n"],
    moved: Float64[np.ndarray, "n 3"],
    invariants: Float64[np.ndarray, "m 3"],
) -> None:
    """Write the displacement at every point, and the invariants of its gradient in the middle of every cell."""
    gradient = np.empty((3, 3))
    for m in range(len(cell_nodes)):
        for i in range(3):
            x, y, z = 0.0, 0.0, 0.0
            for corner in range(8):
                value = nodal[cell_nodes[m, corner], i]
                x += value if corner & 4 else -value
                y += value if corner & 2 else -value
                z += value if corner & 1 else -value
            gradient[i, 0], gradient[i, 1], gradient[i, 2] = 0.25 * cells * x, 0.25 * cells * y, 0.25 * cells * z
        g = gradient
        minor_x = g[1, 1] * g[2, 2] - g[1, 2] * g[2, 1]
        minor_y = g[0, 0] * g[2, 2] - g[0, 2] * g[2, 0]
        minor_z = g[0, 0] * g[1, 1] - g[0, 1] * g[1, 0]
        invariants[m, 0] = g[0, 0] + g[1, 1] + g[2, 2]
        invariants[m, 1] = minor_x + minor_y + minor_z
        invariants[m, 2] = (
            g[0, 0] * minor_x
            - g[0, 1] * (g[1, 0] * g[2, 2] - g[1, 2] * g[2, 0])
            + g[0, 2] * (g[1, 0] * g[2, 1] - g[1, 1] * g[2, 0])
        )
    for row in range(len(place)):
        m = cell[row]
        x = place[row, 0] * cells - active[m, 0]
        y = place[row, 1] * cells - active[m, 1]
        z = place[row, 2] * cells - active[m, 2]
        for axis in range(3):
            a = nodal[cell_nodes[m, 0], axis] * (1 - z) + nodal[cell_nodes[m, 1], axis] * z
            b = nodal[cell_nodes[m, 2], axis] * (1 - z) + nodal[cell_nodes[m, 3], axis] * z
            c = nodal[cell_nodes[m, 4], axis] * (1 - z) + nodal[cell_nodes[m, 5], axis] * z
            d = nodal[cell_nodes[m, 6], axis] * (1 - z) + nodal[cell_nodes[m, 7], axis] * z
            moved[row, axis] = (a * (1 - y) + b * y) * (1 - x) + (c * (1 - y) + d * y) * x


@compiled
def _volumes(
    factor: float,
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
    kept, volume = 0.0, 0.0
    for row in range(len(place)):
        m = cell[row]
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
