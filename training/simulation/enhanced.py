"""The hexahedron with enhanced strains: exact in bending, at twice the cost of the plain one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from training.simulation import material_law
from training.simulation.elements import (
    GAUSS_POINTS,
    PAIRS_9,
    PAIRS_24,
    VOID_STIFFNESS,
    ElementState,
    ElementTangent,
    Hexahedron,
    inverted,
)

_ENTRY = np.zeros((9, 9), int)
_ENTRY[PAIRS_9] = np.arange(45)
_ENTRY[PAIRS_9[1], PAIRS_9[0]] = np.arange(45)


class EnhancedHexahedron(Hexahedron):
    """Trilinear hexahedron with nine incompatible modes a cell (Q1/E9), all of the energy at the 2×2×2 Gauss points.

    The deformation gradient is enhanced by F_ij += α_ij s_j(ξ), s_j = ξ_j less its mean over the cell's material, so
    that a constant stress does no work on it and the patch test holds. These are the gradients of the quadratic bubbles
    1 − ξ_j² of Wilson and Taylor: they remove the parasitic shear of bending and, in the same stroke, almost all of the
    volumetric locking. The parameters α are local to the cell and minimise its energy.

    Source: Simo and Armero, IJNME 33 (1992), section 5.2; Simo, Armero and Taylor, CMAME 110 (1993); Taylor, Beresford
    and Wilson, IJNME 10 (1976).
    """

    internal = 9

    def __init__(self, cell_edge: float, octant_fill: Float64[np.ndarray, "8 cells"], poisson_ratio: float) -> None:
        super().__init__(cell_edge, octant_fill, poisson_ratio)
        place = 2.0 * GAUSS_POINTS - 1.0
        share = self.weights / np.maximum(self.weights.sum(axis=0), 1e-300)
        mean = place.T @ share
        # (3, gauss, cells); no enhancement where there is nothing to enhance
        self._modes = (place.T[:, :, None] - mean[:, None, :]) * (self.weights > 0.0)
        # the modes of a cell whose material sits at one Gauss point are zero there: a spring holds their parameters
        self._spring = (VOID_STIFFNESS * cell_edge**3 / 3.0) * (1.0 - octant_fill.mean(axis=0)) + 1e-9 * cell_edge**3

    def evaluate(
        self, displacements: Float64[np.ndarray, "24 cells"], parameters: Float64[np.ndarray, "9 cells"]
    ) -> ElementState:
        """See `Element.evaluate`."""
        gradient = self.full_gradient(displacements, parameters)
        cofactor, jacobian = material_law.cofactor(gradient)
        jacobian = self.material_jacobian(jacobian)
        smallest = float(jacobian.min())
        if not smallest > 0.0:
            return inverted(displacements, parameters, smallest)
        log = np.log(jacobian)
        squared = np.einsum("gcm,gcm->gm", gradient, gradient)
        void = self.void_forces(displacements)
        energy = (self.weights * (0.5 * self.mu * (squared - 3.0) - self.mu * log + 0.5 * self.lam * log**2)).sum(0)
        energy += 0.5 * (displacements * void).sum(axis=0) + 0.5 * self._spring * (parameters**2).sum(axis=0)
        # weighted first Piola-Kirchhoff stress: μ F + (λ ln J − μ) F⁻ᵀ
        stress = gradient * (self.mu * self.weights)[:, None]
        stress += cofactor * (self.weights * (self.lam * log - self.mu) / jacobian)[:, None]
        forces = self.operator_flat.T @ stress.reshape(72, -1) + void
        internal = np.empty_like(parameters)
        for entry in range(9):
            internal[entry] = (stress[:, entry] * self._modes[entry % 3]).sum(axis=0)
        internal += self._spring * parameters
        return ElementState(energy, forces, internal, smallest)

    def tangent(
        self, displacements: Float64[np.ndarray, "24 cells"], parameters: Float64[np.ndarray, "9 cells"]
    ) -> ElementTangent:
        """See `Element.tangent`.

        A cell whose internal parameters are past a maximum of their energy is given its tangent at rest, so that the
        elimination stays that of a minimum.
        """
        tangent, good = self._tangent(displacements, parameters)
        if good.all():
            return tangent
        rest, _ = self._tangent(np.zeros_like(displacements), np.zeros_like(parameters))
        return ElementTangent(
            np.where(good, tangent.stiffness, rest.stiffness),
            np.where(good[:, None, None], tangent.recovery, rest.recovery),
            np.where(good[:, None, None], tangent.compliance, rest.compliance),
        )

    def _tangent(
        self, displacements: Float64[np.ndarray, "24 cells"], parameters: Float64[np.ndarray, "9 cells"]
    ) -> tuple[ElementTangent, np.ndarray]:
        cells = displacements.shape[1]
        cofactor, jacobian = material_law.cofactor(self.full_gradient(displacements, parameters))
        jacobian = self.material_jacobian(jacobian)
        swap = self.weights * (self.mu - self.lam * np.log(jacobian))
        moduli = self.moduli(cofactor, jacobian, swap, self.lam * self.weights)
        stiffness = self.congruence @ moduli.reshape(360, -1) + self.void_stiffness()
        coupling = np.empty((9, 24, cells))
        own = np.empty((cells, 9, 9))
        for entry in range(9):
            image = moduli[:, _ENTRY[entry]] * self._modes[entry % 3][:, None]  # (gauss, 9, cells)
            coupling[entry] = self.operator_flat.T @ image.reshape(72, -1)
            for other in range(entry, 9):
                own[:, entry, other] = (image[:, other] * self._modes[other % 3]).sum(axis=0)
                own[:, other, entry] = own[:, entry, other]
            own[:, entry, entry] += self._spring
        good = np.linalg.eigvalsh(own)[:, 0] > 0.0
        own[~good] = np.eye(9)
        compliance = np.linalg.inv(own)
        cross = np.ascontiguousarray(coupling.transpose(2, 0, 1))
        recovery = compliance @ cross
        stiffness -= (cross.transpose(0, 2, 1) @ recovery)[:, PAIRS_24[0], PAIRS_24[1]].T
        return ElementTangent(stiffness, recovery, compliance), good

    def full_gradient(
        self, displacements: Float64[np.ndarray, "24 cells"], parameters: Float64[np.ndarray, "9 cells"]
    ) -> Float64[np.ndarray, "8 9 cells"]:
        """See `Hexahedron.full_gradient`."""
        gradient = self.deformation_gradient(displacements)
        for entry in range(9):
            gradient[:, entry] += parameters[entry] * self._modes[entry % 3]
        return gradient
