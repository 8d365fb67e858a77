"""From the stiffness of the cells to the factor of the body's."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled
from service.core.prior_cells import Cells
from service.core.prior_factor import PANEL, BandFactor, Ends, Panels, factorised, substitute

_SHIFTS = (0.0, 1e-5, 1e-3, 1e-2)
"""Relative additions to the diagonal until there is a factor: a sheet one voxel thick is too slender for single
precision, and is held a little stiffer than it is."""

Loads = Float32[np.ndarray, "loads 3 n"]


def rest_factor(cells: Cells) -> BandFactor:
    """The factor of a body's stiffness at rest; degree of freedom 3·node + axis.

    Raises:
        np.linalg.LinAlgError: The matrix is far from positive definite.
    """
    panels = -(-3 * cells.around.shape[1] // PANEL)
    ends = _ends(cells, panels)
    width = int((ends - PANEL * np.arange(panels)).max())
    for shift in _SHIFTS:
        upper = np.zeros((panels, PANEL, width), np.float32)
        _assemble(cells, np.float32(1.0 + shift), upper)
        try:
            return factorised(upper, ends)
        except np.linalg.LinAlgError:
            continue
    raise np.linalg.LinAlgError("the stiffness matrix is not positive definite, nor stiffened by a hundredth")


@compiled
def solve_at_rest(factor: BandFactor, force: Loads, result: Loads) -> None:
    """Displacements of the nodes by linear elasticity; the result may be the force."""
    loads, axes, n = force.shape
    values = np.zeros((loads, PANEL * len(factor.ends)), np.float32)
    for load in range(loads):
        for axis in range(axes):
            for v in range(n):
                values[load, 3 * v + axis] = force[load, axis, v]
    substitute(factor, values)
    for load in range(loads):
        for axis in range(axes):
            for v in range(n):
                result[load, axis, v] = values[load, 3 * v + axis]


@compiled
def _ends(cells: Cells, panels: int) -> Ends:
    """One past the last column of each panel: where the cells of its nodes end, or those of a panel before."""
    ends = np.empty(panels, np.int64)
    for k in range(panels):
        ends[k] = PANEL * (k + 1)
    for c in range(cells.own):
        last = 0
        for a in range(8):
            last = max(last, 3 * cells.nodes[a, c] + 3)
        last = (last + PANEL - 1) // PANEL * PANEL
        for a in range(8):
            first = 3 * cells.nodes[a, c]
            ends[first // PANEL] = max(ends[first // PANEL], last)
            ends[(first + 2) // PANEL] = max(ends[(first + 2) // PANEL], last)
    for k in range(1, panels):
        ends[k] = max(ends[k], ends[k - 1])
    return ends


@compiled
def _assemble(cells: Cells, growth: np.float32, upper: Panels) -> None:
    """Add the cells and the bed, and multiply the diagonal by the growth."""
    for a in range(len(cells.nodes)):
        for b in range(len(cells.nodes)):
            for i in range(3):
                for j in range(i if a == b else 0, 3):
                    stiffness = cells.stiffness[3 * a + i, 3 * b + j]
                    for c in range(cells.own):
                        if cells.nodes[a, c] <= cells.nodes[b, c]:
                            _add(upper, 3 * cells.nodes[a, c] + i, 3 * cells.nodes[b, c] + j, stiffness[c])
    for a in range(len(cells.sole)):
        for b in range(len(cells.sole)):
            for f in range(cells.sole.shape[1]):
                if cells.sole[a, f] <= cells.sole[b, f]:
                    for i in range(3):
                        _add(upper, 3 * cells.sole[a, f] + i, 3 * cells.sole[b, f] + i, cells.bed[a, b, f])
    freedoms = 3 * cells.around.shape[1]
    for row in range(PANEL * len(upper)):
        if row < freedoms:
            upper[row // PANEL, row % PANEL, row % PANEL] *= growth
        else:  # the last panel is filled up
            upper[row // PANEL, row % PANEL, row % PANEL] = 1.0


@compiled
def _add(upper: Panels, row: int, column: int, value: np.float32) -> None:
    panel = row // PANEL
    upper[panel, row - PANEL * panel, column - PANEL * panel] += value
