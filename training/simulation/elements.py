"""The eight-node hexahedron on a regular grid: reference gradients, weighted quadrature, element matrices.

All cells of a body are the same cube, so that every element operation is one matrix product of a constant table with
an array whose last axis runs over the cells ("structure of arrays"): displacements are (24, cells), deformation
gradients (8 Gauss points, 9, cells), element stiffnesses (300, cells).

Local node a = 4·dx + 2·dy + dz sits at the corner (dx, dy, dz) of its cell; local degree of freedom 3·a + i is its
displacement along axis i; component 3·i + j of a deformation gradient is F_ij = δ_ij + ∂u_i/∂X_j.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from jaxtyping import Float64, Int

from training.simulation import material_law

CORNERS: Int[np.ndarray, "8 3"] = np.array([[a >> 2 & 1, a >> 1 & 1, a & 1] for a in range(8)])
"""Corner (dx, dy, dz) of each local node; also the octant of each Gauss point."""

PAIRS_24 = np.triu_indices(24)
"""Rows and columns of the 300 entries that a symmetric element matrix is stored as."""
PAIRS_9 = np.triu_indices(9)
"""Rows and columns of the 45 entries of the symmetric moduli ∂P/∂F."""

EMPTY_OCTANT = 0.02
"""Octants holding less material than this count as empty; their Gauss point lies far from what they hold."""
VOID_STIFFNESS = 1e-3
"""Young's modulus of the empty part of a cell, of that of the body: enough that no node hangs free."""

GAUSS_POINTS: Float64[np.ndarray, "8 3"] = 0.5 + (CORNERS - 0.5) / np.sqrt(3.0)
"""Local coordinates of the 2×2×2 Gauss points, one in each octant."""


def shape_functions(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 8"]:
    """Trilinear shape functions at local coordinates in [0, 1]³.

    Source: Hughes, The Finite Element Method (2000), eq. 3.5.2.
    """
    factors = np.where(CORNERS[None] == 1, points[:, None, :], 1.0 - points[:, None, :])
    return np.asarray(factors.prod(axis=2))


def shape_gradients(points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 8 3"]:
    """Gradients of the trilinear shape functions with respect to the local coordinates."""
    factors = np.where(CORNERS[None] == 1, points[:, None, :], 1.0 - points[:, None, :])
    signs = np.where(CORNERS == 1, 1.0, -1.0)
    gradients = np.empty((len(points), 8, 3))
    for axis in range(3):
        others = [other for other in range(3) if other != axis]
        gradients[:, :, axis] = signs[:, axis] * factors[:, :, others].prod(axis=2)
    return gradients


@dataclass(frozen=True)
class ElementState:
    """What one evaluation of the strain energy of all cells gives.

    Attributes:
        energy: Strain energy of each cell; infinite where a Gauss point is inverted.
        forces: Its gradient by the nodal displacements.
        internal_forces: Its gradient by the internal parameters.
        smallest_jacobian: Smallest determinant of the deformation gradient at any Gauss point that holds material.
    """

    energy: Float64[np.ndarray, " cells"]
    forces: Float64[np.ndarray, "24 cells"]
    internal_forces: Float64[np.ndarray, "internal cells"]
    smallest_jacobian: float


@dataclass(frozen=True)
class ElementTangent:
    """Second derivatives of the strain energy of all cells, with the internal parameters eliminated.

    Attributes:
        stiffness: Upper triangle of K_uu − K_uα K_αα⁻¹ K_αu.
        recovery: K_αα⁻¹ K_αu: minus this times the displacements are the internal parameters that follow.
        compliance: K_αα⁻¹.
    """

    stiffness: Float64[np.ndarray, "300 cells"]
    recovery: Float64[np.ndarray, "cells internal 24"]
    compliance: Float64[np.ndarray, "cells internal internal"]


class Element(Protocol):
    """A law of the cell: strain energy of nodal displacements and of internal parameters, for Young's modulus 1."""

    internal: int
    """Internal parameters of a cell, over which the energy is minimised."""

    def evaluate(
        self, displacements: Float64[np.ndarray, "24 cells"], parameters: Float64[np.ndarray, "internal cells"]
    ) -> ElementState:
        """Energy and its gradient."""

    def tangent(
        self, displacements: Float64[np.ndarray, "24 cells"], parameters: Float64[np.ndarray, "internal cells"]
    ) -> ElementTangent:
        """Hessian of the energy; at rest this is the stiffness of linear elasticity."""


class Hexahedron:
    """What all elements share: the trilinear kinematics, the weights, and the near-nothing outside the body.

    Args:
        cell_edge: In units of L.
        octant_fill: Part of each octant that holds material. Each Gauss point stands for the material of its own
            octant, which is what makes cells at a curved surface behave.
        poisson_ratio: ν in [0, 0.49].

    Source: finite cells: Parvizian, Düster and Rank, Comput. Mech. 41 (2007).
    """

    internal: int

    def __init__(self, cell_edge: float, octant_fill: Float64[np.ndarray, "8 cells"], poisson_ratio: float) -> None:
        self.mu, self.lam = material_law.lame(poisson_ratio)
        volume = cell_edge**3
        self.weights = np.where(octant_fill < EMPTY_OCTANT, 0.0, octant_fill) * (volume / 8.0)
        self.cells = octant_fill.shape[1]
        gradients = shape_gradients(GAUSS_POINTS) / cell_edge
        operator = np.zeros((8, 9, 24))
        for i in range(3):
            for j in range(3):
                operator[:, 3 * i + j, i::3] = gradients[:, :, j]
        self.operator = operator  # (gauss, 9, 24): displacements to displacement gradient
        self.operator_flat = operator.reshape(72, 24)
        # The empty part of a cell is filled with a linear material of almost no stiffness: its Gauss points may turn
        # inside out without a cost, which an energy with ln J could not bear.
        self.void = VOID_STIFFNESS * (1.0 - octant_fill.mean(axis=0))
        # of symmetric strains, ν = 0: one that resisted rotations stiffened slender bodies by a third
        transposed = operator[:, [0, 3, 6, 1, 4, 7, 2, 5, 8]]
        strain = 0.5 * (operator + transposed)
        self._void_matrix = np.einsum("gca,gcb->ab", strain, strain) * volume / 8.0
        self._void_pairs = self._void_matrix[PAIRS_24][:, None]

    @cached_property
    def congruence(self) -> Float64[np.ndarray, "300 360"]:
        """Constant matrix taking the 8 × 45 symmetric moduli of a cell to its 300 stiffness entries, Σ Gᵀ A G."""
        return _congruence_table(self.operator)

    def deformation_gradient(self, displacements: Float64[np.ndarray, "24 cells"]) -> Float64[np.ndarray, "8 9 cells"]:
        """F at the Gauss points."""
        gradient = (self.operator_flat @ displacements).reshape(8, 9, -1)
        gradient[:, [0, 4, 8]] += 1.0
        return np.asarray(gradient)

    def full_gradient(
        self, displacements: Float64[np.ndarray, "24 cells"], parameters: Float64[np.ndarray, "internal cells"]
    ) -> Float64[np.ndarray, "8 9 cells"]:
        """F at the Gauss points, with what the internal parameters add."""
        return self.deformation_gradient(displacements)

    def material_jacobian(self, jacobian: Float64[np.ndarray, "8 cells"]) -> Float64[np.ndarray, "8 cells"]:
        """Determinants where there is material, and 1 where there is none."""
        return np.where(self.weights > 0.0, jacobian, 1.0)

    def void_forces(self, displacements: Float64[np.ndarray, "24 cells"]) -> Float64[np.ndarray, "24 cells"]:
        """Forces of the empty part; half their product with the displacements is its energy."""
        return np.asarray((self._void_matrix @ displacements) * self.void)

    def void_stiffness(self) -> Float64[np.ndarray, "300 cells"]:
        """Constant stiffness of the empty part."""
        return np.asarray(self._void_pairs * self.void)

    def moduli(
        self,
        cofactor: Float64[np.ndarray, "8 9 cells"],
        jacobian: Float64[np.ndarray, "8 cells"],
        swap: Float64[np.ndarray, "8 cells"],
        outer: Float64[np.ndarray, "8 cells"],
    ) -> Float64[np.ndarray, "8 45 cells"]:
        """Weighted ∂P/∂F = w μ 1⊗1 + swap F⁻ᵀ_il F⁻ᵀ_kj + outer F⁻ᵀ_ij F⁻ᵀ_kl, upper triangle.

        Args:
            cofactor: J F⁻ᵀ.
            jacobian: J.
            swap: Weighted coefficient of the second term.
            outer: Weighted coefficient of the third.
        """
        inverse = cofactor / jacobian[:, None]
        identity = self.mu * self.weights
        result = np.empty((8, 45, cofactor.shape[2]))
        for index, (row, column) in enumerate(zip(*PAIRS_9, strict=True)):
            i, j, k, m = row // 3, row % 3, column // 3, column % 3
            entry = swap * inverse[:, 3 * i + m]
            entry *= inverse[:, 3 * k + j]
            entry += outer * inverse[:, row] * inverse[:, column]
            if row == column:
                entry += identity
            result[:, index] = entry
        return result


def inverted(
    displacements: Float64[np.ndarray, "24 cells"],
    parameters: Float64[np.ndarray, "internal cells"],
    smallest_jacobian: float,
) -> ElementState:
    """The state of a body with a Gauss point turned inside out: infinite energy."""
    energy = np.full(displacements.shape[1], np.inf)
    return ElementState(
        energy, np.full_like(displacements, np.nan), np.full_like(parameters, np.nan), smallest_jacobian
    )


def _congruence_table(operator: Float64[np.ndarray, "8 9 24"]) -> Float64[np.ndarray, "300 360"]:
    rows, columns = PAIRS_24
    table = np.empty((8, 45, 300))
    for index, (c, d) in enumerate(zip(*PAIRS_9, strict=True)):
        entry = operator[:, c][:, rows] * operator[:, d][:, columns]
        if c != d:
            entry = entry + operator[:, d][:, rows] * operator[:, c][:, columns]
        table[:, index] = entry
    return np.ascontiguousarray(table.reshape(360, 300).T)
