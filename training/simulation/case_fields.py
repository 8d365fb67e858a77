"""What a solved case says of every cell: von Mises stress and smallest volume ratio."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from training.simulation import material_law
from training.simulation.elements import Hexahedron
from training.simulation.solved_case import SolvedCase
from training.simulation.stress import linear_von_mises, von_mises


def cell_fields(solved: SolvedCase) -> tuple[Float64[np.ndarray, " m"], Float64[np.ndarray, " m"]]:
    """Von Mises stress at each cell's centre, in Pa, and the smallest volume ratio at Gauss points with material."""
    body, state, element = solved.body, solved.state, solved.solver.element
    linear = solved.case.law == "linear"
    stress = linear_von_mises(solved.solver, state.displacement) if linear else von_mises(solved.solver, state)
    moved = body.gather(state.displacement)
    assert isinstance(element, Hexahedron)  # the stress above was read at its Gauss points
    gradient = element.full_gradient(moved, state.parameters)
    jacobian = element.material_jacobian(material_law.cofactor(gradient)[1])
    return stress * solved.case.material.young_modulus_pa, np.asarray(jacobian.min(axis=0))
