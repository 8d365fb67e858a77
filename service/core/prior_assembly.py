"""From the stiffness of the cells to the factor of the body's."""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled
from service.core.prior_cells import Cells
from service.core.prior_factor import PANEL, Ends, Panels, add
from service.core.prior_twisted import TwistedFactor, factorised, row_count, solve
from service.core.spread import Spread, in_turn

_SHIFTS = (0.0, 1e-5, 1e-3, 1e-2)
"""Relative additions to the diagonal until there is a factor: a sheet one voxel thick is too slender for single
precision, and is held a little stiffer than it is."""

Loads = Float32[np.ndarray, "loads 3 n"]


def rest_factor(cells: Cells, spread: Spread = in_turn) -> TwistedFactor:
    """The factor of a body's stiffness at rest; degree of freedom 3·node + axis.

    Args:
        cells: Of the body.
        spread: Cores for its two parts.

    Raises:
        np.linalg.LinAlgError: The matrix is far from positive definite.
    """
    ends, backward_ends = _ends(cells, False), _ends(cells, True)
    for shift in _SHIFTS:
        assemble = partial(_assemble, cells, np.float32(1.0 + shift), len(ends))
        try:
            return factorised(ends, backward_ends, assemble, spread)
        except np.linalg.LinAlgError:
            continue
    raise np.linalg.LinAlgError("the stiffness matrix is not positive definite, nor stiffened by a hundredth")


@compiled
def solve_at_rest(factor: TwistedFactor, force: Loads, result: Loads) -> None:
    """Displacements of the nodes by linear elasticity; the result may be the force."""
    loads, axes, n = force.shape
    values = np.zeros((loads, row_count(factor)), np.float32)
    for load in range(loads):
        for axis in range(axes):
            for v in range(n):
                values[load, 3 * v + axis] = force[load, axis, v]
    solve(factor, values)
    for load in range(loads):
        for axis in range(axes):
            for v in range(n):
                result[load, axis, v] = values[load, 3 * v + axis]


@compiled
def _ends(cells: Cells, backward: bool) -> Ends:
    """One past the last column of each panel: where the cells of its nodes end, or those of a panel before."""
    panels = -(-3 * cells.around.shape[1] // PANEL)
    ends = np.empty(panels, np.int64)
    for k in range(panels):
        ends[k] = PANEL * (k + 1)
    for c in range(cells.own):
        last = 0
        for a in range(8):
            last = max(last, _place(cells.nodes[a, c], panels, backward) + 3)
        last = (last + PANEL - 1) // PANEL * PANEL
        for a in range(8):
            first = _place(cells.nodes[a, c], panels, backward)
            ends[first // PANEL] = max(ends[first // PANEL], last)
            ends[(first + 2) // PANEL] = max(ends[(first + 2) // PANEL], last)
    for k in range(1, panels):
        ends[k] = max(ends[k], ends[k - 1])
    return ends


@compiled
def _place(node: int, panels: int, backward: bool) -> int:
    """The first of the three rows of a node."""
    return PANEL * panels - 3 * node - 3 if backward else 3 * node


@compiled
def _assemble(
    cells: Cells, growth: np.float32, panels: int, upper: Panels, end: int, backward: bool
) -> None:
    """Add the cells and the bed, and multiply the diagonal by the growth, see `prior_twisted.Assemble`."""
    last = PANEL * panels - 1
    for a in range(len(cells.nodes)):
        for b in range(len(cells.nodes)):
            for i in range(3):
                for j in range(i if a == b else 0, 3):
                    stiffness = cells.stiffness[3 * a + i, 3 * b + j]
                    for c in range(cells.own):
                        row, column = 3 * cells.nodes[a, c] + i, 3 * cells.nodes[b, c] + j
                        if cells.nodes[a, c] <= cells.nodes[b, c] and (column >= end) == backward:
                            if backward:
                                row, column = last - column, last - row
                            add(upper, row, column, stiffness[c])
    for a in range(len(cells.sole)):
        for b in range(len(cells.sole)):
            for f in range(cells.sole.shape[1]):
                for i in range(3):
                    row, column = 3 * cells.sole[a, f] + i, 3 * cells.sole[b, f] + i
                    if row <= column and (column >= end) == backward:
                        if backward:
                            row, column = last - column, last - row
                        add(upper, row, column, cells.bed[a, b, f])
    for k in range(len(upper)):
        for p in range(PANEL):
            upper[k, p, p] *= growth
    for row in range(3 * cells.around.shape[1], last + 1):  # the last panel is filled up
        if (row >= end) == backward:
            place = last - row if backward else row
            add(upper, place, place, np.float32(1.0))
