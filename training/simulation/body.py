"""A body on a regular grid of cubic cells: which cells hold material and how much, its nodes, its clamp.

Everything is in units of the cube's edge L: the cube is [0, 1]³, z up, the support plane z = 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int
from scipy import ndimage

from training.simulation.elements import CORNERS
from training.simulation.sparsity import SparsityPattern

Distance: TypeAlias = Callable[[Float32[np.ndarray, "n 3"]], Float32[np.ndarray, " n"]]
"""Signed distance to a surface, negative inside, for points in cube coordinates."""

MIN_FILL = 0.01
"""Cells holding less material than this are left out: they add stiffness to nothing that a 64³ grid can show."""
SUBSAMPLES = 4
"""Sample points along each edge of an octant that the surface may cross."""
CLAMP_REACH = 0.5
"""A node on the support plane is clamped where the surface passes within this many cell edges of it."""


class BodyError(ValueError):
    """A shape that cannot be simulated; `reason` is a stable short name for counting what was dropped."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


@dataclass(frozen=True, eq=False)
class Body:
    """Active cells of a shape and the numbering of their nodes.

    Attributes:
        distance: The shape.
        cells: Cells along each edge of the cube.
        active: Index (i, j, k) of every active cell.
        octant_fill: Part of each octant of each active cell that holds material, in [0, 1]; octant 4·dx + 2·dy + dz.
        node_grid: Grid position (i, j, k) of every node of an active cell, from 0 to `cells`.
        cell_nodes: Node number of each corner of each active cell, corner 4·dx + 2·dy + dz.
        clamped: Which nodes are held.
    """

    distance: Distance
    cells: int
    active: Int[np.ndarray, "m 3"]
    octant_fill: Float64[np.ndarray, "8 m"]
    node_grid: Int[np.ndarray, "nodes 3"]
    cell_nodes: Int[np.ndarray, "m 8"]
    clamped: Bool[np.ndarray, " nodes"]
    _cell_of_grid: Int[np.ndarray, "n n n"] = field(repr=False)

    @classmethod
    def from_distance(cls, distance: Distance, cells: int = 24) -> Body:
        """Fill a grid of cells³ cells from a signed distance function.

        Raises:
            BodyError: nothing is inside, nothing touches the support plane, or the shape leaves the cube.
        """
        fill = octant_fill(distance, cells)
        return cls.from_fill(distance, fill)

    @classmethod
    def from_fill(cls, distance: Distance, fill: Float64[np.ndarray, "n2 n2 n2"]) -> Body:
        """Number the nodes of a grid of octant fill fractions with two octants along each edge of a cell."""
        n = fill.shape[0] // 2
        octants = fill.reshape(n, 2, n, 2, n, 2).transpose(0, 2, 4, 1, 3, 5).reshape(n, n, n, 8)
        solid = octants.mean(axis=3) >= MIN_FILL
        if not solid.any():
            raise BodyError("empty", "no cell holds material: the shape lies outside the cube or is too thin")
        plane = np.stack(np.meshgrid(np.arange(n + 1), np.arange(n + 1), [0], indexing="ij"), axis=-1).reshape(-1, 3)
        ground = (distance((plane / n).astype(np.float32)) < CLAMP_REACH / n).reshape(n + 1, n + 1)
        # islands that touch the rest only along an edge or a corner, or not at all, are not held by anything
        labels, count = ndimage.label(solid)
        touched = ground[:-1, :-1] | ground[1:, :-1] | ground[:-1, 1:] | ground[1:, 1:]
        standing = np.unique(labels[:, :, 0][touched & solid[:, :, 0]])
        standing = standing[standing > 0]
        if len(standing) == 0:
            raise BodyError("not_standing", "the shape does not touch the support plane z = 0")
        if count > len(standing):
            kept = np.isin(labels, standing)
            lost = float(octants[solid & ~kept].sum() / octants[solid].sum())
            if lost > 0.01:
                raise BodyError("disconnected", f"{lost:.0%} of the shape is not connected to the support plane")
            solid = kept
        active = np.argwhere(solid)
        corners = active[:, None, :] + CORNERS[None]
        flat = np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), (n + 1,) * 3)
        used, cell_nodes = np.unique(flat, return_inverse=True)
        node_grid = np.stack(np.unravel_index(used, (n + 1,) * 3), axis=1)
        clamped = (node_grid[:, 2] == 0) & ground[node_grid[:, 0], node_grid[:, 1]]
        if clamped.sum() < 3:
            raise BodyError("not_standing", "the shape touches the support plane in fewer than three nodes")
        cell_of_grid = np.full((n, n, n), -1)
        cell_of_grid[solid] = np.arange(len(active))
        weights = octants[solid].T.astype(np.float64)
        return cls(
            distance=distance,
            cells=n,
            active=active,
            octant_fill=weights,
            node_grid=node_grid,
            cell_nodes=cell_nodes.reshape(-1, 8),
            clamped=clamped,
            _cell_of_grid=cell_of_grid,
        )

    @property
    def cell_edge(self) -> float:
        """Edge of a cell in units of L."""
        return 1.0 / self.cells

    @property
    def nodes(self) -> int:
        """How many nodes the active cells have."""
        return len(self.node_grid)

    @cached_property
    def node_positions(self) -> Float64[np.ndarray, "nodes 3"]:
        """Rest position of every node."""
        return self.node_grid * self.cell_edge

    @cached_property
    def fill(self) -> Float64[np.ndarray, " m"]:
        """Part of each active cell that holds material."""
        return np.asarray(self.octant_fill.mean(axis=0))

    @property
    def volume(self) -> float:
        """Volume of the body in units of L³."""
        return float(self.octant_fill.sum()) * self.cell_edge**3 / 8.0

    @cached_property
    def free_dof(self) -> Int[np.ndarray, " dof"]:
        """Degrees of freedom 3·node + axis that are not clamped."""
        return np.flatnonzero(np.repeat(~self.clamped, 3))

    @cached_property
    def pattern(self) -> SparsityPattern:
        """Where the element matrices go in the global one."""
        return SparsityPattern.of(self.cell_nodes, self.clamped)

    def locate(self, points: Float64[np.ndarray, "n 3"]) -> tuple[Int[np.ndarray, " n"], Float64[np.ndarray, "n 3"]]:
        """Active cell of each point (−1 where there is none) and its local coordinates in [0, 1]³."""
        scaled = points * self.cells
        index = np.clip(np.floor(scaled).astype(np.int64), 0, self.cells - 1)
        inside = ((scaled >= 0.0) & (scaled <= self.cells)).all(axis=1)
        cell = np.where(inside, self._cell_of_grid[tuple(index.T)], -1)
        return cell, scaled - index

    def gather(self, nodal: Float64[np.ndarray, "nodes 3"]) -> Float64[np.ndarray, "24 m"]:
        """Nodal vectors in element order, cells last."""
        return np.ascontiguousarray(nodal[self.cell_nodes].reshape(-1, 24).T)

    def scatter(self, element: Float64[np.ndarray, "24 m"]) -> Float64[np.ndarray, "nodes 3"]:
        """Sum element vectors into nodal ones."""
        nodal = np.empty((self.nodes, 3))
        index = self.cell_nodes.T.ravel()
        for axis in range(3):
            nodal[:, axis] = np.bincount(index, weights=element[axis::3].ravel(), minlength=self.nodes)
        return nodal

    def surface_points(
        self, count: int, rng: np.random.Generator
    ) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
        """Points spread evenly over the surface above the ground, with their outward unit normals.

        Points are drawn in a thin shell around the surface and projected along the gradient of the distance.

        Raises:
            BodyError: the surface could not be sampled, which happens when `distance` is not close to a distance.
        """
        partial = self.active[self._near_surface]
        points = np.empty((0, 3))
        normals = np.empty((0, 3))
        shell = 0.25 * self.cell_edge
        for _ in range(8):
            cell = partial[rng.integers(len(partial), size=8 * count)]
            drawn = (cell + rng.random((len(cell), 3))) * self.cell_edge
            drawn = drawn[np.abs(self.distance(drawn.astype(np.float32))) < shell]
            projected, normal = project_to_surface(self.distance, drawn)
            residual = np.abs(self.distance(projected.astype(np.float32)))
            good = (residual < 1e-3) & (projected[:, 2] > 0.02) & (projected < 1.0).all(axis=1)
            good &= (self.locate(projected - 0.01 * self.cell_edge * normal)[0] >= 0) & (projected > 0.0).all(axis=1)
            points = np.concatenate([points, projected[good]])
            normals = np.concatenate([normals, normal[good]])
            if len(points) >= count:
                return points[:count], normals[:count]
        raise BodyError("surface_not_found", f"found {len(points)} of {count} points on the surface")

    @cached_property
    def _near_surface(self) -> Bool[np.ndarray, " m"]:
        centres = (self.active + 0.5) * self.cell_edge
        return np.abs(self.distance(centres.astype(np.float32))) < 1.2 * self.cell_edge


def octant_fill(distance: Distance, cells: int) -> Float64[np.ndarray, "n2 n2 n2"]:
    """Part of each of the (2·cells)³ octants that lies inside, by counting sample points.

    Octants whose corners and centre agree and lie farther away than half a diagonal are settled at once.
    """
    n = 2 * cells
    edge = 1.0 / n
    axis = (np.arange(n, dtype=np.float32) + 0.5) * np.float32(edge)
    centres = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    value = distance(centres)
    fill = (value < 0).astype(np.float64)
    # 1.2 times the half diagonal: a margin for functions that are only nearly distances
    near = np.flatnonzero(np.abs(value) < 1.2 * 0.5 * np.sqrt(3.0) * edge)
    offset = ((np.arange(SUBSAMPLES, dtype=np.float32) + 0.5) / SUBSAMPLES - 0.5) * np.float32(edge)
    offsets = np.stack(np.meshgrid(offset, offset, offset, indexing="ij"), axis=-1).reshape(-1, 3)
    for block in np.array_split(near, max(1, len(near) // 4096)):
        samples = (centres[block][:, None] + offsets[None]).reshape(-1, 3)
        fill[block] = (distance(samples) < 0).reshape(len(block), SUBSAMPLES**3).mean(axis=1)
    return fill.reshape(n, n, n)


def surface_gradient(distance: Distance, points: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 3"]:
    """Gradient of a signed distance by central differences, float32-safe step."""
    step = 1e-3
    shifts = np.concatenate([step * np.eye(3), -step * np.eye(3)])
    samples = (points[None] + shifts[:, None]).reshape(-1, 3).astype(np.float32)
    value = distance(samples).astype(np.float64).reshape(6, -1)
    return np.asarray(((value[:3] - value[3:]) / (2.0 * step)).T)


def project_to_surface(
    distance: Distance, points: Float64[np.ndarray, "n 3"], steps: int = 3
) -> tuple[Float64[np.ndarray, "n 3"], Float64[np.ndarray, "n 3"]]:
    """Nearest points on the surface by Newton's method along the gradient, and outward unit normals there."""
    projected = points.copy()
    for _ in range(steps):
        gradient = surface_gradient(distance, projected)
        value = distance(projected.astype(np.float32)).astype(np.float64)
        projected -= gradient * (value / np.maximum((gradient**2).sum(axis=1), 1e-6))[:, None]
    gradient = surface_gradient(distance, projected)
    normal = gradient / np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), 1e-9)
    return projected, normal
