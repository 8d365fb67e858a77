"""Loads: a dead traction over a smooth patch of the surface around a contact point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int

from service.core.arrays import Vector3
from training.simulation.body import Body
from training.simulation.compiled import compiled
from training.simulation.elements import GAUSS_POINTS, shape_functions
from training.simulation.patch import surface_patch
from training.simulation.surface import surface_gradient

PATCH_RADIUS = 0.1
"""Default patch radius in units of L; a point load in three dimensions diverges under refinement."""

FACING = 0.1
"""Least cosine between the outward normals of a place that carries traction and of the contact: above zero, or rounding
would decide whether the sides of a box at right angles to the contact's face carry any."""


class LoadError(ValueError):
    """A load that touches no material."""

    reason = "load_off_body"


@dataclass(frozen=True)
class Load:
    """A force Λ·direction spread with weight (1 − r²/R²)² over the surface within R of the contact.

    Attributes:
        contact: Place on the surface, in units of L.
        direction: Unit vector of the force.
        load_number: Λ = F/(E L²), not negative.
        patch_radius: R in units of L.
    """

    contact: Vector3
    direction: Vector3
    load_number: float
    patch_radius: float = PATCH_RADIUS


def nodal_forces(body: Body, loads: Load | Sequence[Load]) -> Float64[np.ndarray, "nodes 3"]:
    """Work-equivalent nodal forces of a load, or of several that act together.

    Raises:
        LoadError: no material lies under a patch.
    """
    if isinstance(loads, Load):
        return _patch_forces(body, loads)
    return np.asarray(sum((_patch_forces(body, load) for load in loads), np.zeros((body.nodes, 3))))


def _patch_forces(body: Body, load: Load) -> Float64[np.ndarray, "nodes 3"]:
    """Nodal forces of one load; they sum to Λ·direction exactly.

    The surface integral is taken over points of a fine lattice that lie in a thin shell around the surface, projected
    onto it. Only the side of a thin member that faces the contact carries traction: the outward normal there must have
    a component along the normal at the contact.
    """
    spacing = min(0.25 * body.cell_edge, load.patch_radius / 10.0)
    points, normals, area = surface_patch(body.distance, load.contact, load.patch_radius, spacing)
    outward = surface_gradient(body.distance, load.contact[None])[0]
    squared = ((points - load.contact) ** 2).sum(axis=1) / load.patch_radius**2
    weight = np.clip(1.0 - squared, 0.0, None) ** 2 * area
    weight *= normals @ outward > FACING
    loaded = weight > 0.0
    cell, local = body.settle(points[loaded], normals[loaded])
    if not (cell >= 0).any():
        raise LoadError("no material lies under the load's patch: move the contact onto the surface")
    nodal = np.zeros(body.nodes)
    _spread(cell, local, weight[loaded], body.cell_nodes, nodal)
    return np.asarray((nodal / nodal.sum())[:, None] * (load.load_number * load.direction))


@compiled
def _spread(
    cell: Int[np.ndarray, " n"],
    local: Float64[np.ndarray, "n 3"],
    weight: Float64[np.ndarray, " n"],
    cell_nodes: Int[np.ndarray, "m 8"],
    nodal: Float64[np.ndarray, " nodes"],
) -> None:
    """Add the weight of every point that has a cell to its corners, by their shape functions."""
    for row in range(len(cell)):
        if cell[row] < 0:
            continue
        x, y, z = local[row, 0], local[row, 1], local[row, 2]
        for corner in range(8):
            share = x if corner & 4 else 1.0 - x
            share *= y if corner & 2 else 1.0 - y
            share *= z if corner & 1 else 1.0 - z
            nodal[cell_nodes[cell[row], corner]] += share * weight[row]


def self_weight(body: Body, weight_number: Vector3) -> Float64[np.ndarray, "nodes 3"]:
    """Nodal forces of a uniform body force.

    Args:
        body: The body.
        weight_number: ρ g L / E times the unit vector of gravity.
    """
    volume = body.octant_fill * (body.cell_edge**3 / 8.0)
    share = shape_functions(GAUSS_POINTS).T @ volume
    nodal = np.bincount(body.cell_nodes.T.ravel(), weights=share.ravel(), minlength=body.nodes)
    return np.asarray(nodal[:, None] * weight_number)
