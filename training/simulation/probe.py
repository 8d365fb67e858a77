"""Displacements at chosen points: inside the body, on its surface, or on a stalk that stands off it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.spatial import cKDTree

from service.core.arrays import Vector3
from training.simulation.body import Body
from training.simulation.case import CaseError
from training.simulation.elements import shape_functions, shape_gradients
from training.simulation.nearest import nearest_on_surface
from training.simulation.solved_case import SolvedCase

TRUSTED_FILL = 0.3
"""Cells with less material than this are read from the nearest fuller one: their outer nodes move freely."""
LONGEST_STALK = 0.1
"""Farthest that a probe may stand off the surface, as a part of the body's longest edge."""
ON_SURFACE = 1e-3
"""Distances below this part of the longest edge count as none."""


class ProbeOffBody(CaseError):
    def __init__(self, message: str, *, distance_m: float) -> None:
        super().__init__(message)
        self.distance_m = distance_m


@dataclass(frozen=True, eq=False)
class Reading:
    """What a probe reads.

    Attributes:
        point_m: Where it was at rest, in the axes of the mesh.
        displacement_m: How it moved.
        stalk_m: How far it stands off the surface; 0 in the body.
    """

    point_m: Vector3
    displacement_m: Vector3
    stalk_m: float


class Interpolation:
    """The displacement field of a body between its nodes.

    Args:
        body: The body.
        displacement: Of its nodes, in units of L.
    """

    def __init__(self, body: Body, displacement: Float64[np.ndarray, "nodes 3"]) -> None:
        self._body = body
        self._displacement = displacement
        trusted = np.flatnonzero(body.fill >= min(TRUSTED_FILL, float(body.fill.max())))
        self._trusted = trusted
        # a cube is the nearest centre in the maximum norm
        self._centres = cKDTree((body.active[trusted] + 0.5) * body.cell_edge)

    def at(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
        """Displacement at points in cube coordinates; beyond the cells that hold material the nearest one's goes on."""
        cell, local = self._locate(points)
        nodal = self._displacement[self._body.cell_nodes[cell]]
        return np.asarray(np.einsum("na,nai->ni", shape_functions(local), nodal), np.float64)

    def gradient(self, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3 3"]:
        """∂u_i/∂X_j at points."""
        cell, local = self._locate(points)
        nodal = self._displacement[self._body.cell_nodes[cell]]
        gradients = shape_gradients(local) / self._body.cell_edge
        return np.asarray(np.einsum("naj,nai->nij", gradients, nodal), np.float64)

    def _locate(self, points: Float64[np.ndarray, "n 3"]) -> tuple[np.ndarray, Float64[np.ndarray, "n 3"]]:
        cell = self._trusted[self._centres.query(points, p=np.inf)[1]]
        local = points * self._body.cells - self._body.active[cell]
        return cell, np.clip(local, -0.5, 1.5)


def read_probe(solved: SolvedCase, point_m: Vector3) -> Reading:
    """Displacement of a point of the body, or of a marker on a rigid stalk that stands on the nearest surface.

    A stalk moves and turns with the surface it stands on: u(p) = u(s) + (R − 1)(p − s), R the rotation of the polar
    decomposition of F(s); by the linear law R − 1 is the antisymmetric part of the gradient.

    Raises:
        ProbeOffBody: the point is farther from the body than a tenth of its longest edge.

    Source: Bonet and Wood (2008), eq. 4.24, for the polar decomposition.
    """
    placement = solved.placement
    field = Interpolation(solved.body, solved.state.displacement)
    point = placement.to_cube(point_m[None])
    nearest = nearest_on_surface(solved.case.triangles_m, point_m)
    outside = float(solved.body.distance(point.astype(np.float32))[0]) > 0
    if not outside or nearest.distance_m <= ON_SURFACE * placement.longest_m:
        return Reading(point_m, field.at(point)[0] * placement.edge_m, 0.0)
    if nearest.distance_m > LONGEST_STALK * placement.longest_m:
        raise ProbeOffBody(
            f"the probe at {point_m.tolist()} m is {nearest.distance_m:.3g} m off the body; the nearest surface is at "
            f"{nearest.point_m.round(6).tolist()} m",
            distance_m=nearest.distance_m,
        )
    foot = placement.to_cube(nearest.point_m[None])
    gradient = field.gradient(foot)[0]
    if solved.case.law == "linear":
        turn = 0.5 * (gradient - gradient.T)
    else:
        left, _, right = np.linalg.svd(np.eye(3) + gradient)
        turn = left @ right - np.eye(3)
    moved = field.at(foot)[0] * placement.edge_m + turn @ (point_m - nearest.point_m)
    return Reading(point_m, np.asarray(moved, np.float64), nearest.distance_m)
