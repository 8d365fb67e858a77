"""The point of a triangle surface that is nearest to another point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from service.core.arrays import Vector3
from training.simulation.distance_grid import Triangles


@dataclass(frozen=True, eq=False)
class Nearest:
    """A point on a surface.

    Attributes:
        point_m: Where.
        distance_m: How far from the point that was asked for.
    """

    point_m: Vector3
    distance_m: float


def nearest_on_surface(triangles_m: Triangles, point_m: Vector3) -> Nearest:
    """Compare all triangles: exact, and quick enough for a handful of points."""
    points_m = np.broadcast_to(point_m, (len(triangles_m), 3))
    feet = trimesh.triangles.closest_point(triangles_m, points_m)
    distance_m = np.linalg.norm(feet - point_m, axis=1)
    best = int(distance_m.argmin())
    return Nearest(np.asarray(feet[best], np.float64), float(distance_m[best]))
