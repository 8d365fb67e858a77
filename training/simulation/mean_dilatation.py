"""The plain hexahedron that does not lock: one compiled pass over the cells for their forces, one for stiffness."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from service.core.compiled import compiled
from training.simulation.elements import (
    CORNERS,
    GAUSS_POINTS,
    ElementState,
    ElementTangent,
    Hexahedron,
    inverted,
    shape_gradients,
)
from training.simulation.trilinear import coefficients, corner_sums

_GRADIENTS: Float64[np.ndarray, "gauss=8 node=8 axis=3"] = shape_gradients(GAUSS_POINTS)
_PRODUCTS: Float64[np.ndarray, "gauss=8 node=8 node=8"] = np.einsum("gaj,gbj->gab", _GRADIENTS, _GRADIENTS)
_PLACES: Float64[np.ndarray, "gauss=8 axis=3"] = (CORNERS - 0.5) / np.sqrt(3.0)
"""Gauss points from the middle of the cell, in its edges."""
_TOGETHER = 8
"""Cells whose stiffnesses are written in one go: 64 bytes of each of the 300 rows, a line of the cache."""


class MeanDilatationHexahedron(Hexahedron):
    """Trilinear hexahedron whose volumetric energy is taken at the element's mean volume ratio.

    μ/2 (tr FᵀF − 3) − μ ln J is integrated at the 2×2×2 Gauss points, the λ part, λ/2 ln² J̄, once an element with
    J̄ = Σ w J / Σ w: it cannot lock as ν → ½. Linearised at rest it is Hughes' B̄ element with selective integration.
    Cheap, but too stiff where a member in bending is few cells thick.

    Source: Hughes (2000) section 4.5; Nagtegaal, Parks and Rice, CMAME 4 (1974); Bonet and Wood, Nonlinear Continuum
    Mechanics (2008) section 8.6.
    """

    internal = 0

    def __init__(self, cell_edge: float, octant_fill: Float64[np.ndarray, "8 cells"], poisson_ratio: float) -> None:
        super().__init__(cell_edge, octant_fill, poisson_ratio)
        self._cells_per_edge = 1.0 / cell_edge

    def evaluate(
        self, displacements: Float64[np.ndarray, "24 cells"], parameters: Float64[np.ndarray, "0 cells"]
    ) -> ElementState:
        """See `Element.evaluate`."""
        forces = self.void_forces(displacements)
        energy = 0.5 * (displacements * forces).sum(axis=0)
        smallest = _add_forces(
            displacements, self.weights, self.mu, self.lam, self._cells_per_edge, _PLACES, energy, forces
        )
        if not smallest > 0.0:
            return inverted(displacements, parameters, smallest)
        return ElementState(energy, forces, np.zeros_like(parameters), smallest)

    def tangent(
        self, displacements: Float64[np.ndarray, "24 cells"], parameters: Float64[np.ndarray, "0 cells"]
    ) -> ElementTangent:
        """See `Element.tangent`."""
        stiffness = self.void_stiffness()
        _add_stiffness(
            displacements, self.weights, self.mu, self.lam, self._cells_per_edge, _PLACES, _GRADIENTS, _PRODUCTS,
            stiffness,
        )  # fmt: skip
        cells = displacements.shape[1]
        return ElementTangent(stiffness, np.zeros((cells, 0, 24)), np.zeros((cells, 0, 0)))


@compiled
def _kinematics(
    displacements: Float64[np.ndarray, "24 cells"],
    cell: int,
    weights: Float64[np.ndarray, "8 cells"],
    scale: float,
    places: Float64[np.ndarray, "8 3"],
    terms: Float64[np.ndarray, "3 8"],
    gradient: Float64[np.ndarray, "8 9"],
    cofactor: Float64[np.ndarray, "8 9"],
    jacobian: Float64[np.ndarray, " 8"],
) -> tuple[float, float, float]:
    """Write F, cof F and J at the Gauss points of a cell that hold material; Σ w, J̄, and the smallest J."""
    for axis in range(3):
        (
            terms[axis, 0], terms[axis, 1], terms[axis, 2], terms[axis, 3],
            terms[axis, 4], terms[axis, 5], terms[axis, 6], terms[axis, 7],
        ) = coefficients(
            displacements[axis, cell], displacements[3 + axis, cell], displacements[6 + axis, cell],
            displacements[9 + axis, cell], displacements[12 + axis, cell], displacements[15 + axis, cell],
            displacements[18 + axis, cell], displacements[21 + axis, cell],
        )  # fmt: skip
    volume, total, smallest = 0.0, 0.0, np.inf
    for gauss in range(8):
        weight = weights[gauss, cell]
        if not weight > 0.0:
            continue
        x, y, z = places[gauss, 0], places[gauss, 1], places[gauss, 2]
        # whole indices, no views: a view would count its references, which takes longer than the sums
        for i in range(3):
            gradient[gauss, 3 * i] = scale * (terms[i, 1] + y * terms[i, 4] + z * terms[i, 6] + y * z * terms[i, 7])
            gradient[gauss, 3 * i + 1] = scale * (terms[i, 2] + x * terms[i, 4] + z * terms[i, 5] + x * z * terms[i, 7])
            gradient[gauss, 3 * i + 2] = scale * (terms[i, 3] + y * terms[i, 5] + x * terms[i, 6] + x * y * terms[i, 7])
            gradient[gauss, 4 * i] += 1.0
        a, b, c = gradient[gauss, 0], gradient[gauss, 1], gradient[gauss, 2]
        d, e, f = gradient[gauss, 3], gradient[gauss, 4], gradient[gauss, 5]
        g, h, k = gradient[gauss, 6], gradient[gauss, 7], gradient[gauss, 8]
        p, q, r = e * k - f * h, f * g - d * k, d * h - e * g
        cofactor[gauss, 0], cofactor[gauss, 1], cofactor[gauss, 2] = p, q, r
        cofactor[gauss, 3], cofactor[gauss, 4], cofactor[gauss, 5] = h * c - k * b, k * a - g * c, g * b - h * a
        cofactor[gauss, 6], cofactor[gauss, 7], cofactor[gauss, 8] = b * f - c * e, c * d - a * f, a * e - b * d
        jacobian[gauss] = a * p + b * q + c * r
        smallest = min(smallest, jacobian[gauss])
        volume += weight
        total += weight * jacobian[gauss]
    # a cell without a filled octant keeps only its void stiffness
    return volume, total / volume if volume > 0.0 else 1.0, smallest


@compiled
def _add_forces(
    displacements: Float64[np.ndarray, "24 cells"],
    weights: Float64[np.ndarray, "8 cells"],
    mu: float,
    lam: float,
    scale: float,
    places: Float64[np.ndarray, "8 3"],
    energy: Float64[np.ndarray, " cells"],
    forces: Float64[np.ndarray, "24 cells"],
) -> float:
    """Add the energy and the forces of the material; the smallest J, at which it stops where that is not positive."""
    terms, dual, jacobian = np.empty((3, 8)), np.empty((3, 8)), np.empty(8)
    gradient, cofactor = np.empty((8, 9)), np.empty((8, 9))
    lowest = 1.0 if (weights <= 0.0).any() else np.inf
    for cell in range(displacements.shape[1]):
        volume, mean, smallest = _kinematics(
            displacements, cell, weights, scale, places, terms, gradient, cofactor, jacobian
        )
        if volume == 0.0:
            continue
        lowest = min(lowest, smallest)
        if not smallest > 0.0:
            return lowest
        log_mean = np.log(mean)
        pressure = lam * log_mean / mean
        stored = 0.5 * lam * volume * log_mean**2
        dual[:] = 0.0
        for gauss in range(8):
            weight = weights[gauss, cell]
            if not weight > 0.0:
                continue
            x, y, z = places[gauss, 0], places[gauss, 1], places[gauss, 2]
            squared = 0.0
            for entry in range(9):
                squared += gradient[gauss, entry] ** 2
            stored += weight * mu * (0.5 * (squared - 3.0) - np.log(jacobian[gauss]))
            # first Piola-Kirchhoff stress: μ F + (p − μ/J) cof F
            spherical = weight * scale * (pressure - mu / jacobian[gauss])
            shear = weight * scale * mu
            for i in range(3):
                p = shear * gradient[gauss, 3 * i] + spherical * cofactor[gauss, 3 * i]
                q = shear * gradient[gauss, 3 * i + 1] + spherical * cofactor[gauss, 3 * i + 1]
                r = shear * gradient[gauss, 3 * i + 2] + spherical * cofactor[gauss, 3 * i + 2]
                dual[i, 1] += p
                dual[i, 2] += q
                dual[i, 3] += r
                dual[i, 4] += y * p + x * q
                dual[i, 5] += z * q + y * r
                dual[i, 6] += z * p + x * r
                dual[i, 7] += y * z * p + x * z * q + x * y * r
        energy[cell] += stored
        for axis in range(3):
            a, b, c, d, e, f, g, h = corner_sums(
                0.0, dual[axis, 1], dual[axis, 2], dual[axis, 3],
                dual[axis, 4], dual[axis, 5], dual[axis, 6], dual[axis, 7],
            )  # fmt: skip
            forces[axis, cell] += a
            forces[3 + axis, cell] += b
            forces[6 + axis, cell] += c
            forces[9 + axis, cell] += d
            forces[12 + axis, cell] += e
            forces[15 + axis, cell] += f
            forces[18 + axis, cell] += g
            forces[21 + axis, cell] += h
    return lowest


@compiled
def _add_stiffness(
    displacements: Float64[np.ndarray, "24 cells"],
    weights: Float64[np.ndarray, "8 cells"],
    mu: float,
    lam: float,
    scale: float,
    places: Float64[np.ndarray, "8 3"],
    gradients: Float64[np.ndarray, "8 8 3"],
    products: Float64[np.ndarray, "8 8 8"],
    stiffness: Float64[np.ndarray, "300 cells"],
) -> None:
    """Add the stiffness of the material.

    With g_a = F⁻ᵀ ∇N_a and p = λ ln J̄ / J̄, the block of nodes a and b is the sum over Gauss points of
    w (μ ∇N_a·∇N_b 1 + (μ − p J) g_b ⊗ g_a + p J g_a ⊗ g_b), and λ V (1 − ln J̄)/J̄² h_a ⊗ h_b, h_a = Σ w J g_a / V.
    """
    terms, jacobian = np.empty((3, 8)), np.empty(8)
    gradient, cofactor = np.empty((8, 9)), np.empty((8, 9))
    spatial, swapped, outer = np.empty((8, 24)), np.empty((8, 24)), np.empty((8, 24))
    shear, mean, block = np.empty(8), np.empty(24), np.empty((300, _TOGETHER))
    cells = displacements.shape[1]
    for start in range(0, cells, _TOGETHER):
        count = min(_TOGETHER, cells - start)
        for column in range(count):
            cell = start + column
            volume, ratio, _ = _kinematics(
                displacements, cell, weights, scale, places, terms, gradient, cofactor, jacobian
            )
            if volume == 0.0:
                block[:, column] = 0.0
                continue
            ratio = ratio if ratio > 0.0 else 1.0
            log_ratio = np.log(ratio)
            pressure = lam * log_ratio / ratio
            mean[:] = 0.0
            for gauss in range(8):
                weight = weights[gauss, cell]
                if not weight > 0.0:
                    shear[gauss], spatial[gauss], swapped[gauss], outer[gauss] = 0.0, 0.0, 0.0, 0.0
                    continue
                local = jacobian[gauss]
                shear[gauss] = weight * mu * scale * scale
                for a in range(8):
                    for i in range(3):
                        value = (
                            cofactor[gauss, 3 * i] * gradients[gauss, a, 0]
                            + cofactor[gauss, 3 * i + 1] * gradients[gauss, a, 1]
                            + cofactor[gauss, 3 * i + 2] * gradients[gauss, a, 2]
                        ) * (scale / local)
                        spatial[gauss, 3 * a + i] = value
                        swapped[gauss, 3 * a + i] = weight * (mu - pressure * local) * value
                        outer[gauss, 3 * a + i] = weight * pressure * local * value
                        mean[3 * a + i] += weight * local / volume * value
            bulk = volume * lam * (1.0 - log_ratio) / ratio**2
            for a in range(8):
                p0, p1, p2 = bulk * mean[3 * a], bulk * mean[3 * a + 1], bulk * mean[3 * a + 2]
                for b in range(a, 8):
                    # nine sums in registers
                    q0, q1, q2, same = mean[3 * b], mean[3 * b + 1], mean[3 * b + 2], 0.0
                    k00, k01, k02 = p0 * q0, p0 * q1, p0 * q2
                    k10, k11, k12 = p1 * q0, p1 * q1, p1 * q2
                    k20, k21, k22 = p2 * q0, p2 * q1, p2 * q2
                    for gauss in range(8):
                        same += shear[gauss] * products[gauss, a, b]
                        s0, s1, s2 = swapped[gauss, 3 * b], swapped[gauss, 3 * b + 1], swapped[gauss, 3 * b + 2]
                        g0, g1, g2 = spatial[gauss, 3 * a], spatial[gauss, 3 * a + 1], spatial[gauss, 3 * a + 2]
                        o0, o1, o2 = outer[gauss, 3 * a], outer[gauss, 3 * a + 1], outer[gauss, 3 * a + 2]
                        h0, h1, h2 = spatial[gauss, 3 * b], spatial[gauss, 3 * b + 1], spatial[gauss, 3 * b + 2]
                        k00 += s0 * g0 + o0 * h0
                        k01 += s0 * g1 + o0 * h1
                        k02 += s0 * g2 + o0 * h2
                        k10 += s1 * g0 + o1 * h0
                        k11 += s1 * g1 + o1 * h1
                        k12 += s1 * g2 + o1 * h2
                        k20 += s2 * g0 + o2 * h0
                        k21 += s2 * g1 + o2 * h1
                        k22 += s2 * g2 + o2 * h2
                    # where row p of the upper triangle has its column q: 24 p − p (p + 1)/2 + q
                    row = 3 * a
                    first, second, third = (
                        24 * row - row * (row + 1) // 2 + 3 * b,
                        24 * (row + 1) - (row + 1) * (row + 2) // 2 + 3 * b,
                        24 * (row + 2) - (row + 2) * (row + 3) // 2 + 3 * b,
                    )
                    block[first, column], block[first + 1, column], block[first + 2, column] = k00 + same, k01, k02
                    block[second + 1, column], block[second + 2, column] = k11 + same, k12
                    block[third + 2, column] = k22 + same
                    if b > a:
                        block[second, column], block[third, column], block[third + 1, column] = k10, k20, k21
        for entry in range(300):
            for column in range(count):
                stiffness[entry, start + column] += block[entry, column]
