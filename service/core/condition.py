"""The condition of the deformation network: a material and one load in the body grid, free of units."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from service.core.arrays import Vector3
from service.core.grids import Grid, invert_rigid

CONDITION_FIELDS = (
    "contact_x", "contact_y", "contact_z",
    "direction_x", "direction_y", "direction_z",
    "log10_load_number", "poisson_ratio", "patch_radius",
)  # fmt: skip
"""Contact in edges of the grid (0 to 1 from its corner), unit direction, log10 F/(E L²), ν, and R in edges."""

DEFAULT_PATCH_RADIUS = 0.1
"""Radius of the traction patch in edges of the grid where a load names none."""

POISSON_RATIO_MAX = 0.49
"""Poisson's ratio above this is answered as this: at 0.5 the body is incompressible and displacements alone no longer
determine the stress."""

Condition = Float32[np.ndarray, "condition=9"]


def load_number(force_n: float, young_modulus_pa: float, edge_m: float) -> float:
    """Λ = F/(E L²): with ν and the geometry in units of L, all that a deformation depends on.

    Args:
        force_n: Magnitude of the force, N, not negative.
        young_modulus_pa: Young's modulus, Pa, positive.
        edge_m: Edge L of the body grid, m, positive.

    Source: dimensional analysis of quasi-static elasticity (Buckingham, Phys. Rev. 4, 345, 1914).
    """
    return force_n / (young_modulus_pa * edge_m**2)


def encode_condition(
    grid: Grid, contact_m: Vector3, force_n: Vector3, young_modulus_pa: float, poisson_ratio: float,
    patch_radius_m: float | None,
) -> Condition:  # fmt: skip
    """Material and one load (camera frame) to the condition vector in the frame of the body grid.

    A zero force has no direction and no logarithm; the pipeline answers it without the network.

    Raises:
        ValueError: The force is zero.
    """
    magnitude = float(np.linalg.norm(force_n))
    if magnitude == 0.0:
        raise ValueError("a zero force has no condition vector; answer it with the undeformed body")
    grid_from_camera = invert_rigid(grid.camera_from_grid)
    contact = (grid_from_camera[:3, :3] @ contact_m + grid_from_camera[:3, 3]) / grid.edge_m
    direction = grid_from_camera[:3, :3] @ force_n / magnitude
    radius = DEFAULT_PATCH_RADIUS if patch_radius_m is None else patch_radius_m / grid.edge_m
    return np.array(
        [
            *contact,
            *direction,
            np.log10(load_number(magnitude, young_modulus_pa, grid.edge_m)),
            min(poisson_ratio, POISSON_RATIO_MAX),
            radius,
        ],
        np.float32,
    )
