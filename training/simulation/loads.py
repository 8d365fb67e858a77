"""Loads: a dead traction over a smooth patch of the surface around a contact point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int

from service.core.arrays import Vector3
from service.core.compiled import compiled
from training.simulation.body import Body
from training.simulation.elements import GAUSS_POINTS, shape_functions
from training.simulation.patch import surface_patch
from training.simulation.skin import LATTICE
from training.simulation.surface import surface_gradient

PATCH_RADIUS = 0.1
"""Default patch radius in units of L; a point load in three dimensions diverges under refinement."""

FACING = 0.1
"""Least cosine between the outward normals of a place that carries traction and of the contact: above zero, or rounding
would decide whether the sides of a box at right angles to the contact's face carry any."""
FEWEST = 6.0
"""Spacings of the skin's points in the radius of the smallest patch that is integrated over them."""


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
    return np.asarray(load_cases(body, [loads])[0])


def load_cases(body: Body, cases: Sequence[Load | Sequence[Load]]) -> Float64[np.ndarray, "m nodes 3"]:
    """As `nodal_forces`, for each of several loads, or groups of loads that act together.

    The forces of each load sum to Λ·direction exactly. Its integral is taken over the points of the body's skin, or,
    where those are too far apart for a patch so small, of a finer lattice around the contact. Only the side of a thin
    member that faces the contact carries traction: the outward normal there must have a component along the normal at
    the contact.

    Raises:
        LoadError: no material lies under a patch.
    """
    groups = [(case,) if isinstance(case, Load) else tuple(case) for case in cases]
    loads = [load for group in groups for load in group]
    forces = np.zeros((len(groups), body.nodes, 3))
    if not loads:
        return forces
    outward = surface_gradient(body.distance, np.array([load.contact for load in loads]))
    shares = iter([_shares(body, load, normal) for load, normal in zip(loads, outward, strict=True)])
    for case, group in enumerate(groups):
        for load in group:
            forces[case] += next(shares)[:, None] * (load.load_number * load.direction)
    return forces


def _shares(body: Body, load: Load, outward: Vector3) -> Float64[np.ndarray, " nodes"]:
    """Share of a load that each node carries."""
    if body.skin is not None and load.patch_radius >= FEWEST * body.cell_edge / LATTICE:
        skin, cell, local = body.skin
        points, normals, area = skin.points, skin.normals, skin.area
    else:
        spacing = min(body.cell_edge / LATTICE, load.patch_radius / 10.0)
        points, normals, area = surface_patch(body.distance, load.contact, load.patch_radius, spacing)
        cell, local = body.settle(points, normals)
    nodal = np.zeros(body.nodes)
    _spread(points, normals, area, cell, local, load.contact, load.patch_radius, outward, body.cell_nodes, nodal)
    total = nodal.sum()
    if not total > 0.0:
        raise LoadError("no material lies under the load's patch: move the contact onto the surface")
    return np.asarray(nodal / total)


@compiled
def _spread(
    points: Float64[np.ndarray, "n 3"],
    normals: Float64[np.ndarray, "n 3"],
    area: Float64[np.ndarray, " n"],
    cell: Int[np.ndarray, " n"],
    local: Float64[np.ndarray, "n 3"],
    contact: Vector3,
    radius: float,
    outward: Vector3,
    cell_nodes: Int[np.ndarray, "m 8"],
    nodal: Float64[np.ndarray, " nodes"],
) -> None:
    """Add the weight of every point of a patch that has a cell to its corners, by their shape functions."""
    for row in range(len(points)):
        x, y, z = points[row, 0] - contact[0], points[row, 1] - contact[1], points[row, 2] - contact[2]
        squared = (x * x + y * y + z * z) / radius**2
        if squared >= 1.0 or cell[row] < 0:
            continue
        facing = normals[row, 0] * outward[0] + normals[row, 1] * outward[1] + normals[row, 2] * outward[2]
        if facing <= FACING:
            continue
        weight = (1.0 - squared) ** 2 * area[row]
        x, y, z = local[row, 0], local[row, 1], local[row, 2]
        for corner in range(8):
            share = x if corner & 4 else 1.0 - x
            share *= y if corner & 2 else 1.0 - y
            share *= z if corner & 1 else 1.0 - z
            nodal[cell_nodes[cell[row], corner]] += share * weight


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
