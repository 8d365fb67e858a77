"""Where in the unit cube a mesh is simulated: the map between its own axes in metres and cube coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float64, Shaped

from service.core.arrays import Vector3
from training.simulation import clamp as clamps
from training.simulation.distance_grid import Triangles

REGION_SLACK = 0.01
"""Surfaces this part of a cell beyond a clamp's region count as in it: faces lie on its border."""


@dataclass(frozen=True, eq=False)
class Box:
    """A part of space whose surface is held, in metres and the mesh's axes; infinite bounds make half spaces of it.

    Attributes:
        low: Corner with the smallest coordinates.
        high: Corner with the largest.
    """

    low: Vector3
    high: Vector3


Points: TypeAlias = Shaped[np.ndarray, "*points 3"]


@dataclass(frozen=True, eq=False)
class Placement:
    """The axes of cube and mesh are parallel: p_cube = (p_m − origin_m)/edge_m.

    Attributes:
        origin_m: Corner (0, 0, 0) of the cube in the mesh's axes.
        edge_m: Edge L of the cube.
        cells: Along that edge.
        longest_m: Longest edge of the mesh's box.
    """

    origin_m: Vector3
    edge_m: float
    cells: int
    longest_m: float

    @classmethod
    def of(cls, triangles_m: Triangles, cells: int, fill: float, held: Sequence[Box] = ()) -> Placement:
        """Centre a mesh in the cube, or stand it on z = 0 where nothing is said of how it is held.

        Along each axis a plane of nodes is laid through the border of the first box that ends within the mesh, else
        through the mesh's low side, and the longest edge takes a whole number of cells: flat ends and borders are then
        met exactly.

        Args:
            triangles_m: The mesh.
            cells: Along the cube's edge.
            fill: Part of the cube's edge that the longest edge of the mesh takes, to half a cell.
            held: Regions in which it is held.
        """
        corners = triangles_m.reshape(-1, 3)
        low, high = corners.min(axis=0), corners.max(axis=0)
        extent = high - low
        cell_m = float(extent.max()) / max(1, round(fill * cells))
        edge_m = cell_m * cells
        origin_m = np.empty(3)
        for axis in range(3):
            anchor = low[axis]
            for border in [value for box in held for value in (box.low[axis], box.high[axis])][::-1]:
                if low[axis] < border < high[axis]:
                    anchor = border
            room = 0.5 * (edge_m - extent[axis])
            before = round((anchor - low[axis] + room) / cell_m)
            if axis == 2 and not held:
                before = 0
            # at least none of the mesh below the cube
            while anchor - before * cell_m > low[axis] + 1e-9 * edge_m:
                before += 1
            origin_m[axis] = anchor - before * cell_m
        return cls(origin_m, edge_m, cells, float(extent.max()))

    @property
    def cell_m(self) -> float:
        """Edge of a cell."""
        return self.edge_m / self.cells

    def to_cube(self, points_m: Points) -> Float64[np.ndarray, "*points 3"]:
        """Cube coordinates of points in metres."""
        return np.asarray((points_m - self.origin_m) / self.edge_m, np.float64)

    def to_metres(self, points: Points) -> Float64[np.ndarray, "*points 3"]:
        """Points of the cube in metres, in the mesh's axes."""
        return np.asarray(points * self.edge_m + self.origin_m, np.float64)

    def force_unit_n(self, young_modulus_pa: float) -> float:
        """What a force of 1 in the cube is in newtons: E L²."""
        return young_modulus_pa * self.edge_m**2

    def regions(self, held: Sequence[Box]) -> clamps.Region | None:
        """The union of boxes in the cube; none for none, which is the ground."""
        if not held:
            return None
        slack = REGION_SLACK / self.cells
        parts = [clamps.box(self.to_cube(box.low) - slack, self.to_cube(box.high) + slack) for box in held]
        return lambda points: np.asarray(np.any([part(points) for part in parts], axis=0))
