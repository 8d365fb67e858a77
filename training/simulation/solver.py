"""Linear elasticity: one factor a body and Poisson's ratio, all loads as right-hand sides."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float64

from training.simulation.body import Body
from training.simulation.clamp import Reaction
from training.simulation.elements import PAIRS_24, Element, ElementTangent
from training.simulation.factor import Factor, factorise
from training.simulation.loads import Load, load_cases
from training.simulation.mean_dilatation import MeanDilatationHexahedron


class LinearSolver:
    """Small-strain response of one body, Young's modulus 1.

    Args:
        body: The body.
        poisson_ratio: ν in [0, 0.49].
        element: Law of the cell: `MeanDilatationHexahedron`, or `EnhancedHexahedron`, which is exact in bending.
        backend: Factorisation, see `factorise`.
    """

    def __init__(
        self,
        body: Body,
        poisson_ratio: float,
        element: Callable[[float, np.ndarray, float], Element] = MeanDilatationHexahedron,
        backend: str = "auto",
    ) -> None:
        self.body = body
        self.poisson_ratio = poisson_ratio
        self.element = element(body.cell_edge, body.octant_fill, poisson_ratio)
        cells = len(body.active)
        self.tangent = self.element.tangent(np.zeros((24, cells)), np.zeros((self.element.internal, cells)))
        self.stiffness = self.assemble(self.tangent.stiffness)
        self.factor: Factor = factorise(self.stiffness, backend)

    @cached_property
    def tangent_factor(self) -> Factor:
        """A second factor on the same pattern, for the tangents of nonlinear states."""
        return self.factor.twin()

    def assemble(self, element: Float64[np.ndarray, "300 m"]) -> sp.csr_array:
        """Upper triangle of the global matrix over the free degrees of freedom, the foundation's included."""
        pattern = self.body.pattern
        size = len(self.body.free_dof)
        values = pattern.assemble(element) + self.body.foundation_values
        return sp.csr_array((values, pattern.indices, pattern.indptr), shape=(size, size))

    def solve(self, loads: Sequence[Load | Sequence[Load]]) -> Float64[np.ndarray, "m nodes 3"]:
        """Nodal displacements of every load, or of every group of loads that act together, in units of L.

        Raises:
            LoadError: a load touches no material.
        """
        return self.solve_forces(load_cases(self.body, loads))

    def solve_forces(self, forces: Float64[np.ndarray, "m nodes 3"]) -> Float64[np.ndarray, "m nodes 3"]:
        """Nodal displacements under given nodal forces."""
        free = self.body.free_dof
        columns = forces.reshape(len(forces), -1)
        if len(free) == columns.shape[1]:  # as wherever a bed holds the body
            return np.ascontiguousarray(self.factor.solve(columns.T).T).reshape(forces.shape)
        displacements = np.zeros_like(columns)
        displacements[:, free] = self.factor.solve(columns[:, free].T).T
        return displacements.reshape(forces.shape)

    def reaction(
        self, displacements: Float64[np.ndarray, "nodes 3"], forces: Float64[np.ndarray, "nodes 3"]
    ) -> Reaction:
        """What the clamp does to the body: minus the sum of the forces, about the positions at rest."""
        nodal = self.body.clamp_forces(displacements, self.internal_forces(displacements) - forces)
        return Reaction.of(nodal, self.body.node_positions)

    def internal_forces(self, displacements: Float64[np.ndarray, "nodes 3"]) -> Float64[np.ndarray, "nodes 3"]:
        """Nodal forces K u of the strained body: in equilibrium those of the loads and of the clamp."""
        stiffness = self.tangent.stiffness
        full = np.zeros((24, 24, stiffness.shape[1]))
        full[PAIRS_24] = stiffness
        full[PAIRS_24[1], PAIRS_24[0]] = stiffness
        return self.body.scatter(np.einsum("abm,bm->am", full, self.body.gather(displacements)))


@dataclass(frozen=True)
class CondensedFactor:
    """Inverse of a tangent over displacements and internal parameters, by static condensation.

    Source: Guyan, AIAA J. 3 (1965), for the condensation.
    """

    body: Body
    factor: Factor
    tangent: ElementTangent

    def solve(self, vector: Float64[np.ndarray, " dof"]) -> Float64[np.ndarray, " dof"]:
        """Displacements and parameters in equilibrium with a vector of forces on both."""
        free = self.body.free_dof
        internal = vector[len(free) :].reshape(-1, len(self.body.active)).T[:, :, None]
        outer = vector[: len(free)]
        if internal.size:
            recovered = (self.tangent.recovery.transpose(0, 2, 1) @ internal)[:, :, 0].T
            outer = outer - self.body.scatter(np.ascontiguousarray(recovered)).reshape(-1)[free]
        solution = np.empty_like(vector)
        solution[: len(free)] = self.factor.solve(outer[:, None])[:, 0]
        if internal.size:
            full = np.zeros(3 * self.body.nodes)
            full[free] = solution[: len(free)]
            moved = self.body.gather(full.reshape(-1, 3)).T[:, :, None]
            parameters = self.tangent.compliance @ internal - self.tangent.recovery @ moved
            solution[len(free) :] = parameters[:, :, 0].T.ravel()
        return solution
