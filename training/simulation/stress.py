"""Stress in a deformed body: how close it comes to yielding or tearing, and where."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from service.core.compiled import compiled
from training.simulation.elements import Hexahedron
from training.simulation.solution import Solution
from training.simulation.solver import LinearSolver


def von_mises(solver: LinearSolver, solution: Solution) -> Float64[np.ndarray, " cells"]:
    """Von Mises stress of a neo-Hookean body, the mean over the material of each cell, in units of Young's modulus.

    The deviator of Cauchy's stress does not hold the volumetric part of the law: s = μ/J dev(F Fᵀ).

    Source: Bonet and Wood (2008), eq. 6.28; σ_vM = √(3/2 s:s), von Mises (1913).
    """
    element = _hexahedron(solver)
    gradient = element.full_gradient(solver.body.gather(solution.displacement), solution.parameters)
    mean = np.empty(gradient.shape[2])
    _mean_equivalent(gradient, element.weights, element.mu, False, mean)
    return mean


def linear_von_mises(
    solver: LinearSolver, displacement: Float64[np.ndarray, "nodes 3"]
) -> Float64[np.ndarray, " cells"]:
    """The same by Hooke's law, s = 2 μ dev ε with ε the symmetric part of ∂u/∂X, for nodal displacements."""
    element = _hexahedron(solver)
    gathered = solver.body.gather(displacement)
    # the internal parameters follow the displacements
    followed = -np.einsum("mpa,am->pm", solver.tangent.recovery, gathered)
    gradient = element.full_gradient(gathered, followed)
    mean = np.empty(gradient.shape[2])
    _mean_equivalent(gradient, element.weights, element.mu, True, mean)
    return mean


def _hexahedron(solver: LinearSolver) -> Hexahedron:
    if not isinstance(solver.element, Hexahedron):
        raise TypeError(f"stress is read at the Gauss points of a Hexahedron, not of {type(solver.element).__name__}")
    return solver.element


@compiled
def _mean_equivalent(
    gradient: Float64[np.ndarray, "8 9 cells"],
    weights: Float64[np.ndarray, "8 cells"],
    mu: float,
    small: bool,
    mean: Float64[np.ndarray, " cells"],
) -> None:
    """Write √(3/2 s:s), by Hooke's law or Cauchy's stress, averaged over the Gauss points of a cell by their weight."""
    mean[:] = 0.0
    volume = np.zeros(len(mean))
    for gauss in range(8):
        for cell in range(len(mean)):
            weight = weights[gauss, cell]
            if not weight > 0.0:
                continue
            a, b, c = gradient[gauss, 0, cell], gradient[gauss, 1, cell], gradient[gauss, 2, cell]
            d, e, f = gradient[gauss, 3, cell], gradient[gauss, 4, cell], gradient[gauss, 5, cell]
            g, h, k = gradient[gauss, 6, cell], gradient[gauss, 7, cell], gradient[gauss, 8, cell]
            if small:
                scale = mu
                xx, yy, zz, xy, yz, zx = 2.0 * a, 2.0 * e, 2.0 * k, b + d, f + h, g + c
            else:
                scale = mu / (a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g))
                xx, yy, zz = a * a + b * b + c * c, d * d + e * e + f * f, g * g + h * h + k * k
                xy, yz, zx = a * d + b * e + c * f, d * g + e * h + f * k, g * a + h * b + k * c
            square = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2)
            mean[cell] += weight * scale * np.sqrt(square + 3.0 * (xy * xy + yz * yz + zx * zx))
            volume[cell] += weight
    for cell in range(len(mean)):
        if volume[cell] > 0.0:
            mean[cell] /= volume[cell]
