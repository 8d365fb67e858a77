"""Stress in a deformed body: how close it comes to yielding or tearing, and where."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int

from service.core.compiled import compiled
from training.simulation.elements import GAUSS_POINTS, Hexahedron
from training.simulation.solution import Solution
from training.simulation.solver import LinearSolver
from training.simulation.trilinear import coefficients

_PLACES: Float64[np.ndarray, "8 3"] = GAUSS_POINTS - 0.5
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
    places: Float64[np.ndarray, "8 3"],
    weights: Float64[np.ndarray, "8 cells"],
    mu: float,
    small: bool,
    mean: Float64[np.ndarray, " cells"],
) -> None:
    """As `_means`, of trilinear displacements; `scale` is the number of cells along an edge of the cube."""
    terms, f = np.empty((3, 8)), np.empty(9)
    for cell in range(len(mean)):
        for axis in range(3):
            (
                terms[axis, 0], terms[axis, 1], terms[axis, 2], terms[axis, 3],
                terms[axis, 4], terms[axis, 5], terms[axis, 6], terms[axis, 7],
            ) = coefficients(
                nodal[cell_nodes[cell, 0], axis], nodal[cell_nodes[cell, 1], axis],
                nodal[cell_nodes[cell, 2], axis], nodal[cell_nodes[cell, 3], axis],
                nodal[cell_nodes[cell, 4], axis], nodal[cell_nodes[cell, 5], axis],
                nodal[cell_nodes[cell, 6], axis], nodal[cell_nodes[cell, 7], axis],
            )  # fmt: skip
        total, volume = 0.0, 0.0
        for gauss in range(8):
            weight = weights[gauss, cell]
            if not weight > 0.0:
                continue
            x, y, z = places[gauss, 0], places[gauss, 1], places[gauss, 2]
            for i in range(3):
                f[3 * i] = scale * (terms[i, 1] + y * terms[i, 4] + z * terms[i, 6] + y * z * terms[i, 7])
                f[3 * i + 1] = scale * (terms[i, 2] + x * terms[i, 4] + z * terms[i, 5] + x * z * terms[i, 7])
                f[3 * i + 2] = scale * (terms[i, 3] + y * terms[i, 5] + x * terms[i, 6] + x * y * terms[i, 7])
                f[4 * i] += 1.0
            total += weight * _equivalent(f[0], f[1], f[2], f[3], f[4], f[5], f[6], f[7], f[8], mu, small)
            volume += weight
        mean[cell] = total / volume if volume > 0.0 else 0.0
