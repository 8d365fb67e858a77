"""Stress in a deformed body: how close it comes to yielding or tearing, and where."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

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
    f = gradient.reshape(8, 3, 3, -1)
    jacobian = np.linalg.det(f.transpose(0, 3, 1, 2))
    stress = element.mu * np.einsum("gikm,gjkm->gijm", f, f) / element.material_jacobian(jacobian)[:, None, None]
    return _mean(element, stress)


def linear_von_mises(
    solver: LinearSolver, displacement: Float64[np.ndarray, "nodes 3"]
) -> Float64[np.ndarray, " cells"]:
    """The same by Hooke's law, s = 2 μ dev ε with ε the symmetric part of ∂u/∂X, for nodal displacements."""
    element = _hexahedron(solver)
    gathered = solver.body.gather(displacement)
    # the internal parameters follow the displacements
    followed = -np.einsum("mpa,am->pm", solver.tangent.recovery, gathered)
    f = element.full_gradient(gathered, followed).reshape(8, 3, 3, -1)
    return _mean(element, element.mu * (f + f.transpose(0, 2, 1, 3) - 2.0 * np.eye(3)[None, :, :, None]))


def _hexahedron(solver: LinearSolver) -> Hexahedron:
    if not isinstance(solver.element, Hexahedron):
        raise TypeError(f"stress is read at the Gauss points of a Hexahedron, not of {type(solver.element).__name__}")
    return solver.element


def _mean(element: Hexahedron, stress: Float64[np.ndarray, "8 3 3 cells"]) -> Float64[np.ndarray, " cells"]:
    deviator = stress - np.einsum("giim->gm", stress)[:, None, None] / 3.0 * np.eye(3)[None, :, :, None]
    equivalent = np.sqrt(1.5 * np.einsum("gijm,gijm->gm", deviator, deviator))
    weight = element.weights / np.maximum(element.weights.sum(axis=0), 1e-300)
    return np.asarray((weight * equivalent).sum(axis=0))
