"""Stress in a deformed body: how close it comes to yielding or tearing, and where."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int

from service.core.compiled import compiled
from training.simulation.elements import GAUSS_POINTS, Hexahedron
from training.simulation.solution import Solution
from training.simulation.solver import LinearSolver
from training.simulation.trilinear import nodal_coefficients

_PLACES: Float64[np.ndarray, "axis=3 gauss=8"] = np.ascontiguousarray(GAUSS_POINTS.T - 0.5)
"""Gauss points from the middle of the cell, in its edges."""


def von_mises(solver: LinearSolver, solution: Solution) -> Float64[np.ndarray, " cells"]:
    """Von Mises stress of a neo-Hookean body, the mean over the material of each cell, in units of Young's modulus.

    The deviator of Cauchy's stress does not hold the volumetric part of the law: s = μ/J dev(F Fᵀ).

    Source: Bonet and Wood (2008), eq. 6.28; σ_vM = √(3/2 s:s), von Mises (1913).
    """
    return _cell_means(solver, solution.displacement, solution.parameters)


def linear_von_mises(
    solver: LinearSolver, displacement: Float64[np.ndarray, "nodes 3"]
) -> Float64[np.ndarray, " cells"]:
    """The same by Hooke's law, s = 2 μ dev ε with ε the symmetric part of ∂u/∂X, for nodal displacements."""
    return _cell_means(solver, displacement, None)


def _cell_means(
    solver: LinearSolver,
    displacement: Float64[np.ndarray, "nodes 3"],
    parameters: Float64[np.ndarray, "internal cells"] | None,
) -> Float64[np.ndarray, " cells"]:
    """Means over the material of each cell, by Cauchy's stress, or by Hooke's law where no parameters are given."""
    element, body = _hexahedron(solver), solver.body
    mean, small = np.empty(len(body.active)), parameters is None
    if element.internal == 0:
        # straight from the nodes: the gradients of all cells in memory take three times as long
        _trilinear_means(displacement, body.cell_nodes, 1.0 / body.cell_edge, _PLACES, element.weights, element.mu,
                         small, mean)  # fmt: skip
        return mean
    gathered = body.gather(displacement)
    if parameters is None:
        # the internal parameters follow the displacements
        parameters = -np.einsum("mpa,am->pm", solver.tangent.recovery, gathered)
    _means(element.full_gradient(gathered, parameters), element.weights, element.mu, small, mean)
    return mean


def _hexahedron(solver: LinearSolver) -> Hexahedron:
    if not isinstance(solver.element, Hexahedron):
        raise TypeError(f"stress is read at the Gauss points of a Hexahedron, not of {type(solver.element).__name__}")
    return solver.element


@compiled
def _equivalent(
    a: float, b: float, c: float, d: float, e: float, f: float, g: float, h: float, k: float, mu: float, small: bool
) -> float:
    """√(3/2 s:s) of the deformation gradient with rows (a, b, c), (d, e, f), (g, h, k), by Hooke's law or Cauchy's."""
    if small:
        scale = mu
        xx, yy, zz, xy, yz, zx = 2.0 * a, 2.0 * e, 2.0 * k, b + d, f + h, g + c
    else:
        scale = mu / (a * (e * k - f * h) - b * (d * k - f * g) + c * (d * h - e * g))
        xx, yy, zz = a * a + b * b + c * c, d * d + e * e + f * f, g * g + h * h + k * k
        xy, yz, zx = a * d + b * e + c * f, d * g + e * h + f * k, g * a + h * b + k * c
    square = 0.5 * ((xx - yy) ** 2 + (yy - zz) ** 2 + (zz - xx) ** 2)
    return float(scale * np.sqrt(square + 3.0 * (xy * xy + yz * yz + zx * zx)))


@compiled
def _means(
    gradient: Float64[np.ndarray, "8 9 cells"],
    weights: Float64[np.ndarray, "8 cells"],
    mu: float,
    small: bool,
    mean: Float64[np.ndarray, " cells"],
) -> None:
    """Write the stress of given deformation gradients, averaged over the Gauss points of a cell by their weight."""
    for cell in range(len(mean)):
        total, volume = 0.0, 0.0
        for gauss in range(8):
            weight = weights[gauss, cell]
            if weight > 0.0:
                total += weight * _equivalent(
                    gradient[gauss, 0, cell], gradient[gauss, 1, cell], gradient[gauss, 2, cell],
                    gradient[gauss, 3, cell], gradient[gauss, 4, cell], gradient[gauss, 5, cell],
                    gradient[gauss, 6, cell], gradient[gauss, 7, cell], gradient[gauss, 8, cell], mu, small,
                )  # fmt: skip
                volume += weight
        mean[cell] = total / volume if volume > 0.0 else 0.0


@compiled
def _trilinear_means(
    nodal: Float64[np.ndarray, "nodes 3"],
    cell_nodes: Int[np.ndarray, "m 8"],
    scale: float,
    places: Float64[np.ndarray, "3 8"],
    weights: Float64[np.ndarray, "8 cells"],
    mu: float,
    small: bool,
    mean: Float64[np.ndarray, " cells"],
) -> None:
    """As `_means`, of trilinear displacements; `scale` is the number of cells along an edge of the cube."""
    stress = np.empty(8)
    for cell in range(len(mean)):
        p = nodal_coefficients(nodal, cell_nodes, cell, 0)
        q = nodal_coefficients(nodal, cell_nodes, cell, 1)
        r = nodal_coefficients(nodal, cell_nodes, cell, 2)
        # all Gauss points, of material or not, without a question: four at a time
        for gauss in range(8):
            x, y, z = places[0, gauss], places[1, gauss], places[2, gauss]
            stress[gauss] = _equivalent(
                1.0 + scale * (p[1] + y * p[4] + z * p[6] + y * z * p[7]),
                scale * (p[2] + x * p[4] + z * p[5] + x * z * p[7]),
                scale * (p[3] + y * p[5] + x * p[6] + x * y * p[7]),
                scale * (q[1] + y * q[4] + z * q[6] + y * z * q[7]),
                1.0 + scale * (q[2] + x * q[4] + z * q[5] + x * z * q[7]),
                scale * (q[3] + y * q[5] + x * q[6] + x * y * q[7]),
                scale * (r[1] + y * r[4] + z * r[6] + y * z * r[7]),
                scale * (r[2] + x * r[4] + z * r[5] + x * z * r[7]),
                1.0 + scale * (r[3] + y * r[5] + x * r[6] + x * y * r[7]),
                mu, small,
            )  # fmt: skip
        total, volume = 0.0, 0.0
        for gauss in range(8):
            weight = weights[gauss, cell]
            if weight > 0.0:
                total += weight * stress[gauss]
                volume += weight
        mean[cell] = total / volume if volume > 0.0 else 0.0
