"""The part of a surface within a ball, as points to integrate over: what carries a load."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from service.core.arrays import Vector3
from training.simulation.surface import Distance, surface_quadrature


def surface_patch(
    distance: Distance, centre: Vector3, radius: float, spacing: float
) -> tuple[Float64[np.ndarray, "m 3"], Float64[np.ndarray, "m 3"], Float64[np.ndarray, " m"]]:
    """Points on the surface around a place, outward unit normals and areas; see `surface_quadrature`.

    Args:
        distance: The shape.
        centre: Centre of the ball.
        radius: Of the ball.
        spacing: Of the cubic lattice, one of whose points lies at the ball's low corner.
    """
    reach = np.arange(-radius, radius + spacing, spacing)
    lattice = np.stack(np.meshgrid(reach, reach, reach, indexing="ij"), axis=-1).reshape(-1, 3)
    return surface_quadrature(distance, centre + lattice[(lattice**2).sum(axis=1) < radius**2], spacing)
