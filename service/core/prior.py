"""A coarse elastic solve of the body at hand: the physics that the deformation network starts from."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float32

from service.core.arrays import Occupancy
from service.core.condition import POISSON_RATIO_MAX, Condition
from service.core.prior_balance import NeoHookeanSolver
from service.core.prior_field import Points, backward_fields, held
from service.core.prior_grid import CellGrid
from service.core.prior_lattice import forward_lattice
from service.core.prior_load import nodal_forces
from service.core.spread import Spread, in_turn

CELLS = 300
"""Cells with material that a body is cut into, about: bodies with legs and walls fill few of those over their box.
docs/runs.md tells what other numbers give."""

STEPS = 32
"""From the linear solution to a balanced one at most; most loads take five to ten."""


Nodal = Float32[np.ndarray, "loads axis=3 n"]
Balanced = Bool[np.ndarray, " loads"]


@dataclass(frozen=True, eq=False)
class PriorSolution:
    """Answers of the coarse solve for n loads, in edges of the body grid.

    Attributes:
        nodal: Forward displacement of the coarse nodes (see `ElasticPrior.grid`).
        backward: u_b on a lattice of 32³, node i at (i + ½)/32: the material at y was at rest at y − u_b(y). Outside
            the deformed body the field continues smoothly.
        forward: u(x) on a lattice of 16³, node i at (i + ½)/16: where the material at x at rest goes.
        balanced: Whether the material's forces balance the load's; otherwise it is a guess.
    """

    nodal: Nodal
    backward: Float32[np.ndarray, "loads axis=3 x=32 y=32 z=32"]
    forward: Float32[np.ndarray, "loads axis=3 x=16 y=16 z=16"]
    balanced: Balanced


class ElasticPrior:
    """Coarse elasticity of one body: factorised once, then asked for any number of loads.

    Args:
        occupancy: The body in its body grid, z up. It stands on its lowest voxels; what is not connected to them is
            left out.
        poisson_ratio: ν; above 0.49 it is taken as 0.49, as everywhere.
        cells: Cells with material, about.
        spread: Cores for setting it up.

    Raises:
        ValueError: The body is empty.
        np.linalg.LinAlgError: The stiffness matrix could not be factorised, not even made a little stiffer. No
            occupancy is known to do this.
    """

    def __init__(
        self, occupancy: Occupancy, poisson_ratio: float, cells: int = CELLS, spread: Spread = in_turn
    ) -> None:
        self.grid = CellGrid.fit(occupancy, cells)
        self._occupancy = occupancy
        self.solver = NeoHookeanSolver(self.grid, min(poisson_ratio, POISSON_RATIO_MAX), spread)

    @cached_property
    def _points(self) -> Points:
        """Needed last, and in a thread that has time."""
        return Points.of(self.grid)

    def forces(self, conditions: Sequence[Condition]) -> Float32[np.ndarray, "loads 3 n"]:
        """Nodal forces of loads, see `prior_load.nodal_forces`."""
        return nodal_forces(self.grid, self._occupancy, conditions)

    def displacements(self, conditions: Sequence[Condition], steps: int = STEPS) -> PriorSolution:
        """Solve for loads, and make fields of the solutions, see `nodal`."""
        nodal, balanced = self.nodal(conditions, steps)
        return PriorSolution(nodal, self.backward(nodal, balanced), self.forward(nodal), balanced)

    def nodal(self, conditions: Sequence[Condition], steps: int = STEPS) -> tuple[Nodal, Balanced]:
        """Solve for loads, all at once: displacements of the nodes, and which of them balance.

        Args:
            conditions: One a load, at least one, see `service.core.condition`; their ν is not looked at.
            steps: 0 is linear elasticity, see `NeoHookeanSolver.solve`.
        """
        return self.solver.solve(self.forces(conditions), steps)

    def backward(self, nodal: Nodal, balanced: Balanced) -> Float32[np.ndarray, "loads axis=3 x=32 y=32 z=32"]:
        """`PriorSolution.backward` of displacements of the nodes; that of a guess is held, see `prior_field.held`."""
        fields = backward_fields(self._points, self.solver.cells, nodal)
        for load in np.flatnonzero(~balanced):
            fields[load] = held(fields[load])
        return fields

    def forward(self, nodal: Nodal) -> Float32[np.ndarray, "loads axis=3 x=16 y=16 z=16"]:
        """`PriorSolution.forward` of displacements of the nodes."""
        return forward_lattice(self.grid, nodal)
