"""Linear elasticity: one factor a body and Poisson's ratio, all loads as right-hand sides."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Float64

from training.simulation.body import Body
from training.simulation.elements import MeanDilatationHexahedron
from training.simulation.factor import Factor, factorise
from training.simulation.loads import Load, nodal_forces


class LinearSolver:
    """Small-strain response of one body, Young's modulus 1.

    Args:
        body: The body.
        poisson_ratio: ν in [0, 0.49].
        backend: Factorisation, see `factorise`.
    """

    def __init__(self, body: Body, poisson_ratio: float, backend: str = "auto") -> None:
        self.body = body
        self.poisson_ratio = poisson_ratio
        self.element = MeanDilatationHexahedron(body.cell_edge)
        self.stiffness = self.assemble(self.element.stiffness(body.quadrature_weights, poisson_ratio))
        self.factor: Factor = factorise(self.stiffness, backend)
        self._backend = backend

    @cached_property
    def tangent_factor(self) -> Factor:
        """A second factor on the same pattern, for the tangents of nonlinear states; its ordering is found once."""
        return factorise(self.stiffness, self._backend)

    def assemble(self, element: Float64[np.ndarray, "300 m"]) -> sp.csr_array:
        """Upper triangle of the global matrix over the free degrees of freedom."""
        pattern = self.body.pattern
        size = len(self.body.free_dof)
        return sp.csr_array((pattern.assemble(element), pattern.indices, pattern.indptr), shape=(size, size))

    def solve(self, loads: Sequence[Load]) -> Float64[np.ndarray, "m nodes 3"]:
        """Nodal displacements of every load, in units of L.

        Raises:
            LoadError: a load touches no material.
        """
        return self.solve_forces(np.stack([nodal_forces(self.body, load) for load in loads]))

    def solve_forces(self, forces: Float64[np.ndarray, "m nodes 3"]) -> Float64[np.ndarray, "m nodes 3"]:
        """Nodal displacements under given nodal forces."""
        free = self.body.free_dof
        displacements = np.zeros((len(forces), 3 * self.body.nodes))
        displacements[:, free] = self.factor.solve(forces.reshape(len(forces), -1)[:, free].T).T
        return displacements.reshape(len(forces), self.body.nodes, 3)

    def reactions(self, displacements: Float64[np.ndarray, "nodes 3"]) -> Float64[np.ndarray, "nodes 3"]:
        """Internal nodal forces K u: the applied load at free nodes, minus it at clamped ones."""
        stiffness = self.element.stiffness(self.body.quadrature_weights, self.poisson_ratio)
        full = np.zeros((24, 24, stiffness.shape[1]))
        rows, columns = np.triu_indices(24)
        full[rows, columns] = stiffness
        full[columns, rows] = stiffness
        return self.body.scatter(np.einsum("abm,bm->am", full, self.body.gather(displacements)))
