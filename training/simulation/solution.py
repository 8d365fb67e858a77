"""An equilibrium state of a body, and the record of how it was found."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from training.simulation.clamp import Reaction
from training.simulation.loads import Load


@dataclass(frozen=True, eq=False)
class Solution:
    """An equilibrium state, or the reason why there is none.

    Attributes:
        displacement: Nodal displacements in units of L; of the last iterate where not converged.
        parameters: Internal parameters of the cells that belong to it.
        fraction: Part of the full load that this step carries.
        loads: The loads of this step, which act together; empty where nodal forces were given instead.
        reason: None, or `not_converged`, `inverted`, `left_cube`.
        iterations: Newton iterations of this step.
        residual: Norm of the unbalanced nodal forces over that of the load.
        residuals: The residual at the start of the step and after every iteration; the last is `residual`.
        smallest_jacobian: Smallest volume ratio at any Gauss point.
        strain_energy: Of the body, without the clamp's bed, in units of E L³.
        peak_displacement: Largest displacement of a node of a cell at least half full, in units of L.
        reaction: Force and moment of the clamp on the body, at its deformed positions.
    """

    displacement: Float64[np.ndarray, "nodes 3"]
    parameters: Float64[np.ndarray, "internal cells"]
    fraction: float
    loads: tuple[Load, ...]
    reason: str | None
    iterations: int
    residual: float
    residuals: tuple[float, ...]
    smallest_jacobian: float
    strain_energy: float
    peak_displacement: float
    reaction: Reaction

    @property
    def converged(self) -> bool:
        """Whether this is an equilibrium state that may be used."""
        return self.reason is None
