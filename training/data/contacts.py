"""Where and in which direction bodies are pushed."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64

from service.core.arrays import GRID_SIZE, Occupancy, Vector3
from training.simulation.body import Body, BodyError
from training.simulation.surface import project_to_surface

EDGE_REACH = 0.06
"""How far beside a contact, in L, an edge is looked for: about four voxels."""
EDGE_RISE = 0.35
"""Distance to the body at that place, as a part of how far it is, that makes an edge of what lies between: walking on
along the tangent plane leaves a cylinder of radius 0.25 L by 0.12, and a right-angled edge by up to 1."""
CANDIDATES = 12
"""Places that are drawn for each contact wanted."""
TOP_MARGIN = 0.04
"""Part of the body's length that the first and the last place along its top keep from its ends."""


def draw_contacts(
    body: Body, count: int, near_edge: float, rng: np.random.Generator
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Places spread over the surface, a part of them close to edges and rims, with their outward normals.

    Args:
        body: The body.
        count: How many.
        near_edge: Chance of each to be drawn from the places near an edge only.
        rng: Source of randomness.

    Raises:
        BodyError: The surface could not be sampled.
    """
    points, normals = body.surface_points(CANDIDATES * count, rng)
    edged = np.flatnonzero(_rise(body, points, normals) > EDGE_RISE)
    chosen: list[int] = []
    for _ in range(count):
        pool = edged if len(edged) and rng.random() < near_edge else np.arange(len(points))
        free = np.setdiff1d(pool, chosen)
        pick = free if len(free) else np.setdiff1d(np.arange(len(points)), chosen)
        chosen.append(int(pick[rng.integers(len(pick))]))
    return points[chosen], normals[chosen]


def _rise(
    body: Body, points: Float64[np.ndarray, "n 3"], normals: Float64[np.ndarray, "n 3"]
) -> Float64[np.ndarray, " n"]:
    """How far the tangent plane around each place gets away from the body, per length of the way."""
    across = np.cross(normals, np.eye(3)[np.abs(normals).argmin(axis=1)])
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    along = np.cross(normals, across)
    ways = [np.cos(a) * across + np.sin(a) * along for a in 2.0 * np.pi * np.arange(8) / 8]
    beside = np.concatenate([points + EDGE_REACH * way for way in ways])
    return np.asarray(body.distance(beside.astype(np.float32)).reshape(8, -1).max(axis=0) / EDGE_REACH, np.float64)


def draw_direction(normal: Vector3, inward: tuple[float, float], cone: float, rng: np.random.Generator) -> Vector3:
    """The direction of a push.

    Args:
        normal: Outward unit normal at the contact.
        inward: Range of the mixture between a uniformly random direction (0) and straight into the surface (1), which
            pulls and slides as well as it pushes.
        cone: Chance of a push instead: into the surface, at an angle to it uniform between none and tangential.
        rng: Source of randomness.
    """
    random = rng.normal(size=3)
    random /= np.linalg.norm(random)
    share, angle, is_push = rng.uniform(*inward), rng.uniform(0.0, 0.5 * np.pi), rng.random() < cone
    if is_push:
        tangent = random - (random @ normal) * normal
        direction = np.sin(angle) * tangent / max(float(np.linalg.norm(tangent)), 1e-9) - np.cos(angle) * normal
    else:
        direction = (1 - share) * random - share * normal
    return np.asarray(direction / np.linalg.norm(direction))


def along_the_top(body: Body, rest: Occupancy, count: int) -> Float64[np.ndarray, "n 3"]:
    """Equally spaced places along the top of a body, from its lowest x to its highest.

    Each is the highest point of the body at its x, the one nearest to the middle of the body's width where several are
    as high.

    Source: Wang et al., "3D-PhysNet" (IJCAI 2018), section 4.1: "10 positions along the top of the object".

    Raises:
        BodyError: The surface was not found there.
    """
    filled = np.argwhere(rest)
    low, high = filled[:, 0].min(), filled[:, 0].max() + 1
    places = low + (high - low) * (TOP_MARGIN + (1 - 2 * TOP_MARGIN) * (np.arange(count) + 0.5) / count)
    middle = 0.5 * (filled[:, 1].min() + filled[:, 1].max() + 1)
    contacts = []
    for place in places:
        column = filled[filled[:, 0] == int(place)]
        if not len(column):
            raise BodyError("surface_not_found", f"nothing of the body is at x = {place / GRID_SIZE:.2f} L")
        top = column[column[:, 2] == column[:, 2].max()]
        nearest = top[np.abs(top[:, 1] + 0.5 - middle).argmin()] + 0.5
        contacts.append([place, middle if abs(nearest[1] - middle) < 1.0 else nearest[1], nearest[2] + 0.5])
    points, _ = project_to_surface(body.distance, np.array(contacts) / GRID_SIZE)
    if (np.abs(body.distance(points.astype(np.float32))) > 1e-3).any():
        raise BodyError("surface_not_found", "no surface at the top of the body")
    return points
