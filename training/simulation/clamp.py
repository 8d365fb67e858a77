"""How a body is held: a stiff elastic bed under its foot or over any part of its surface, or rigid nodes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float64, Int

from service.core.arrays import Vector3
from training.simulation.sampled import INSIDE, SampledDistance
from training.simulation.surface import Distance, surface_quadrature

Region: TypeAlias = Callable[[Float64[np.ndarray, "n 3"]], Bool[np.ndarray, " n"]]
"""Which points, in cube coordinates, belong to a part of space."""

REACH = 0.01
"""The part of a surface that lies lower than this above the support plane counts as touching it, in units of L."""
STIFFNESS = 500.0
"""Stiffness of the bed: traction over displacement, in units of E/L."""
FOOT_SPACING = 1.0 / 192.0
"""Spacing of the points at which the foot is looked for; finer than `REACH`, and the same on every grid of cells."""
SMALLEST_RADIUS = 2e-3
"""Least radius of gyration of what is held, across its narrowest direction: a body on an edge would turn about it."""


@dataclass(frozen=True, eq=False)
class Bed:
    """Points of the surface that an elastic bed holds, and the stiffness that each stands for.

    Attributes:
        points: In cube coordinates, on the surface.
        normals: Outward there.
        stiffness: κ times the area of each point, in units of E L.
    """

    points: Float64[np.ndarray, "n 3"]
    normals: Float64[np.ndarray, "n 3"]
    stiffness: Float64[np.ndarray, " n"]

    def only(self, chosen: Bool[np.ndarray, " n"]) -> Bed:
        """Some of the points."""
        return Bed(self.points[chosen], self.normals[chosen], self.stiffness[chosen])

    @property
    def holds(self) -> bool:
        """Whether the points spread in two directions, so that no rotation is free."""
        total = self.stiffness.sum()
        if not total > 0.0:
            return False
        offset = self.points - self.stiffness @ self.points / total
        spread = np.linalg.eigvalsh((offset * self.stiffness[:, None]).T @ offset / total)
        return bool(spread[1] > SMALLEST_RADIUS**2)


@dataclass(frozen=True)
class Clamp:
    """The surface near the support plane, or within a region, held by a bed of springs of energy ½ κ ∫ |u|² dA.

    What is held is a property of the shape alone, and its area enters the stiffness: refining the cells converges to
    one body on one foot. Holding whole nodes instead would give a round bottom a foot that shrinks with the cells.

    Attributes:
        region: What part of the surface is held; None for what stands on the plane z = 0.
        reach: Where no region is given, how high above the plane a surface still counts as touching it.
        stiffness: κ in units of E/L.

    Source: Winkler's foundation; Zienkiewicz and Taylor, The Finite Element Method, vol. 1 (2000), section 9.8, for
    prescribing a displacement by a penalty.
    """

    region: Region | None = None
    reach: float = REACH
    stiffness: float = STIFFNESS

    def bed(self, distance: Distance, cells: int) -> Bed:
        """Quadrature of the held surface, for a body of cells³ cells."""
        return self._foot(distance) if self.region is None else self._surface(distance, cells)

    def _foot(self, distance: Distance) -> Bed:
        # The foot is the section of the body at `reach`, seen from below; a point is held where the surface is.
        # The area of the rim is the share of a square inside, by distance; where the bottom is nearly level this lets
        # the hold fade within half a spacing of height.
        axis = np.arange(0.5 * FOOT_SPACING, 1.0, FOOT_SPACING)
        plane = np.stack([*np.meshgrid(axis, axis, indexing="ij"), np.full((len(axis),) * 2, self.reach)], axis=-1)
        points = plane.reshape(-1, 3)
        share = np.zeros(len(points))
        asked = np.arange(len(points))
        if isinstance(distance, SampledDistance):
            octant = tuple(np.floor(points * (2 * distance.cells)).astype(int).T)
            share[:] = distance.state[octant] == INSIDE
            asked = np.flatnonzero(distance.number[octant] >= 0)
        share[asked] = np.clip(
            0.5 - distance(points[asked].astype(np.float32)).astype(np.float64) / FOOT_SPACING, 0.0, 1.0
        )
        points, share = points[share > 0.0], share[share > 0.0]
        points[:, 2] = 0.0
        points[:, 2] = np.clip(distance(points.astype(np.float32)), 0.0, self.reach + 0.5 * FOOT_SPACING)
        down = np.tile([0.0, 0.0, -1.0], (len(points), 1))
        return Bed(points, down, self.stiffness * FOOT_SPACING**2 * share)

    def _surface(self, distance: Distance, cells: int) -> Bed:
        assert self.region is not None
        index = np.stack(np.meshgrid(*[np.arange(-1, cells + 1)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
        near = np.abs(distance(((index + 0.5) / cells).astype(np.float32))) < 1.5 / cells
        step = (np.arange(4) + 0.5) / 4
        inner = np.stack(np.meshgrid(step, step, step, indexing="ij"), axis=-1).reshape(-1, 3)
        lattice = ((index[near, None] + inner) / cells).reshape(-1, 3)
        points, normals, area = surface_quadrature(distance, lattice, 0.25 / cells)
        held = self.region(points)
        return Bed(points, normals, self.stiffness * area).only(held)


@dataclass(frozen=True)
class RigidClamp:
    """Nodes on the plane z = 0 held at rest where the surface passes within half a cell of them.

    For verification against solutions with a built-in end: the foot of a round body depends on the cells.
    """

    reach: float = 0.5

    def nodes(
        self, distance: Distance, node_grid: Int[np.ndarray, "nodes 3"], cells: int
    ) -> Bool[np.ndarray, " nodes"]:
        """Which of the nodes at these grid positions are held."""
        held = node_grid[:, 2] == 0
        held[held] = distance((node_grid[held] / cells).astype(np.float32)) < self.reach / cells
        return np.asarray(held)


@dataclass(frozen=True, eq=False)
class Reaction:
    """What a clamp does to the body it holds, in equilibrium minus the sum of its loads.

    Attributes:
        force: In units of E L².
        moment: About the origin of the cube, in units of E L³.
    """

    force: Vector3
    moment: Vector3

    @classmethod
    def of(cls, nodal: Float64[np.ndarray, "nodes 3"], positions: Float64[np.ndarray, "nodes 3"]) -> Reaction:
        """Sum nodal forces that act at given positions."""
        return cls(nodal.sum(axis=0), np.cross(positions, nodal).sum(axis=0))


def box(low: Vector3, high: Vector3) -> Region:
    """The points of an axis-aligned box."""
    return lambda points: np.asarray(((points >= low) & (points <= high)).all(axis=1))


def half_space(point: Vector3, outward: Vector3) -> Region:
    """The points on the side of a plane through `point` that its normal `outward` points away from."""
    return lambda points: np.asarray((points - point) @ outward <= 0.0)
