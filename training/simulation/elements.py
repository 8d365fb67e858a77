"""The eight-node hexahedron on a regular grid: reference gradients, weighted quadrature, element matrices.

All cells of a body are the same cube, so that every element operation is one matrix product of a constant table with
an array whose last axis runs over the cells ("structure of arrays"): displacements are (24, cells), deformation
gradients (8 Gauss points, 9, cells), element stiffnesses (300, cells).

Local node a = 4·dx + 2·dy + dz sits at the corner (dx, dy, dz) of its cell; local degree of freedom 3·a + i is its
displacement along axis i; component 3·i + j of a deformation gradient is F_ij = δ_ij + ∂u_i/∂X_j.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int

from training.simulation import material_law

CORNERS: Int[np.ndarray, "8 3"] = np.array([[a >> 2 & 1, a >> 1 & 1, a & 1] for a in range(8)])
"""Corner (dx, dy, dz) of each local node; also the octant of each Gauss point."""

PAIRS_24 = np.triu_indices(24)
"""Rows and columns of the 300 entries that a symmetric element matrix is stored as."""

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
        forces: Its gradient, the internal nodal forces.
        smallest_jacobian: Smallest determinant of the deformation gradient at any Gauss point.
    """

    energy: Float64[np.ndarray, " cells"]
    forces: Float64[np.ndarray, "24 cells"]
    smallest_jacobian: float


class MeanDilatationHexahedron:
    """Trilinear hexahedron whose volumetric energy is taken at the element's mean volume ratio.

    The isochoric-like part μ/2 (tr FᵀF − 3) − μ ln J is integrated at the 2×2×2 Gauss points, the λ part,
    λ/2 ln² J̄, once an element with J̄ = Σ w J / Σ w: it cannot lock as ν → ½. Linearised at rest it is the B̄ element
    with the selective integration of Hughes. Each Gauss point carries the material volume of its own octant, which is
    what makes cells at a curved surface behave.

    Source: Hughes (2000) section 4.5; Nagtegaal, Parks and Rice, CMAME 4 (1974); Bonet and Wood, Nonlinear Continuum
    Mechanics (2008) section 8.6; finite cells: Parvizian, Düster and Rank, Comput. Mech. 41 (2007).
    """

    def __init__(self, cell_edge: float) -> None:
        gradients = shape_gradients(GAUSS_POINTS) / cell_edge
        operator = np.zeros((8, 9, 24))
        for i in range(3):
            for j in range(3):
                operator[:, 3 * i + j, i::3] = gradients[:, :, j]
        self._operator = operator  # (gauss, 9, 24): displacements to displacement gradient
        self._operator_flat = operator.reshape(72, 24)
        self._congruence = _congruence_table(operator)
        self._identity_stiffness = np.einsum("gca,gcb->gab", operator, operator)[:, *PAIRS_24]

    def evaluate(
        self,
        displacements: Float64[np.ndarray, "24 cells"],
        weights: Float64[np.ndarray, "8 cells"],
        poisson_ratio: float,
    ) -> ElementState:
        """Strain energy and internal forces for Young's modulus 1."""
        mu, lam = material_law.lame(poisson_ratio)
        gradient = self._deformation_gradient(displacements)
        cofactor, jacobian = material_law.cofactor(gradient)
        smallest = float(jacobian.min())
        if not smallest > 0.0:
            energy = np.full(displacements.shape[1], np.inf)
            return ElementState(energy, np.full_like(displacements, np.nan), smallest)
        volume = weights.sum(axis=0)
        mean_jacobian = (weights * jacobian).sum(axis=0) / volume
        log_mean = np.log(mean_jacobian)
        squared = np.einsum("gcm,gcm->gm", gradient, gradient)
        energy = (weights * (0.5 * mu * (squared - 3.0) - mu * np.log(jacobian))).sum(axis=0)
        energy += volume * 0.5 * lam * log_mean**2
        pressure = lam * log_mean / mean_jacobian
        # weighted first Piola-Kirchhoff stress: μ F + (p − μ/J) cof F
        stress = gradient * (mu * weights)[:, None]
        stress += cofactor * (weights * (pressure - mu / jacobian))[:, None]
        forces = self._operator_flat.T @ stress.reshape(72, -1)
        return ElementState(energy, forces, smallest)

    def tangent(
        self,
        displacements: Float64[np.ndarray, "24 cells"],
        weights: Float64[np.ndarray, "8 cells"],
        poisson_ratio: float,
    ) -> Float64[np.ndarray, "300 cells"]:
        """Hessian of the strain energy of every cell, upper triangle; at rest this is the linear stiffness."""
        mu, lam = material_law.lame(poisson_ratio)
        gradient = self._deformation_gradient(displacements)
        cofactor, jacobian = material_law.cofactor(gradient)
        volume = weights.sum(axis=0)
        mean_jacobian = (weights * jacobian).sum(axis=0) / volume
        log_mean = np.log(mean_jacobian)
        pressure = lam * log_mean / mean_jacobian
        # ∂P/∂F = μ 1⊗1 + (μ − pJ) F⁻ᵀ_il F⁻ᵀ_kj + pJ F⁻ᵀ_ij F⁻ᵀ_kl, the constant first term is in a table of its own
        inverse_transposed = cofactor / jacobian[:, None]
        swap = weights * (mu - pressure * jacobian)
        outer = weights * (pressure * jacobian)
        moduli = np.empty((8, 45, displacements.shape[1]))
        for index, (row, column) in enumerate(zip(*np.triu_indices(9), strict=True)):
            i, j, k, l = row // 3, row % 3, column // 3, column % 3
            entry = swap * inverse_transposed[:, 3 * i + l]
            entry *= inverse_transposed[:, 3 * k + j]
            entry += outer * inverse_transposed[:, row] * inverse_transposed[:, column]
            moduli[:, index] = entry
        stiffness = self._congruence @ moduli.reshape(360, -1)
        stiffness += self._identity_stiffness.T @ (mu * weights)
        # the λ term couples all Gauss points of a cell through J̄: one outer product a cell
        jacobian_gradient = self._operator_flat.T @ (cofactor * (weights / volume)[:, None]).reshape(72, -1)
        coupling = volume * lam * (1.0 - log_mean) / mean_jacobian**2
        scaled = jacobian_gradient * coupling
        start = 0
        for row in range(24):
            stop = start + 24 - row
            stiffness[start:stop] += scaled[row] * jacobian_gradient[row:]
            start = stop
        return stiffness

    def stiffness(
        self, weights: Float64[np.ndarray, "8 cells"], poisson_ratio: float
    ) -> Float64[np.ndarray, "300 cells"]:
        """Linear-elastic stiffness of every cell, upper triangle, for Young's modulus 1."""
        rest = np.zeros((24, 1))
        columns = []
        mu, lam = material_law.lame(poisson_ratio)
        # linear in the weights but for the mean dilatation, which is quadratic over their sum
        for gauss in range(8):
            unit = np.zeros((8, 1))
            unit[gauss] = 1.0
            columns.append(self.tangent(rest, unit, poisson_ratio)[:, 0])
        local = np.stack(columns, axis=1)
        divergence = self._operator[:, [0, 4, 8]].sum(axis=1)  # (8, 24)
        local -= lam * (divergence[:, PAIRS_24[0]] * divergence[:, PAIRS_24[1]]).T
        stiffness = local @ weights
        mean = divergence.T @ weights
        scaled = mean * (lam / weights.sum(axis=0))
        start = 0
        for row in range(24):
            stop = start + 24 - row
            stiffness[start:stop] += scaled[row] * mean[row:]
            start = stop
        return np.asarray(stiffness)

    def _deformation_gradient(
        self, displacements: Float64[np.ndarray, "24 cells"]
    ) -> Float64[np.ndarray, "8 9 cells"]:
        gradient = (self._operator_flat @ displacements).reshape(8, 9, -1)
        gradient[:, [0, 4, 8]] += 1.0
        return np.asarray(gradient)


def _congruence_table(operator: Float64[np.ndarray, "8 9 24"]) -> Float64[np.ndarray, "300 360"]:
    """Constant matrix taking the 8 × 45 symmetric moduli of a cell to its 300 stiffness entries, Σ Gᵀ A G."""
    rows, columns = PAIRS_24
    table = np.empty((8, 45, 300))
    for index, (c, d) in enumerate(zip(*np.triu_indices(9), strict=True)):
        entry = operator[:, c][:, rows] * operator[:, d][:, columns]
        if c != d:
            entry = entry + operator[:, d][:, rows] * operator[:, c][:, columns]
        table[:, index] = entry
    return np.ascontiguousarray(table.reshape(360, 300).T)
