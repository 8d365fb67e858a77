"""A body on a regular grid of cubic cells: which cells hold material and how much, its nodes, its clamp.

Everything is in units of the cube's edge L: the cube is [0, 1]³, z up, the support plane z = 0.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float64, Int
from scipy import ndimage

from service.core.compiled import compiled
from training.simulation.cell_lookup import DEPTHS, locate, settle
from training.simulation.clamp import Bed, Clamp, RigidClamp
from training.simulation.element_order import gather, scatter
from training.simulation.elements import CORNERS, shape_functions
from training.simulation.sampled import SampledDistance
from training.simulation.skin import Skin
from training.simulation.sparsity import SparsityPattern
from training.simulation.surface import Distance, project_to_surface

MIN_FILL = 0.01
"""Cells holding less material than this are left out: they add stiffness to nothing that a 64³ grid can show."""


class BodyError(ValueError):
    """A shape that cannot be simulated; `reason` is a stable short name for counting what was dropped."""

    def __init__(self, reason: str, message: str) -> None:
        super().__init__(message)
        self.reason = reason


_ON_THE_GROUND = Clamp()


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
        clamped: Which nodes are held rigidly; none where an elastic bed holds the body.
        foundation: Stiffness of that bed between nodes, the same along all three axes, in units of E L.
    """

    distance: Distance
    cells: int
    active: Int[np.ndarray, "m 3"]
    octant_fill: Float64[np.ndarray, "8 m"]
    node_grid: Int[np.ndarray, "nodes 3"]
    cell_nodes: Int[np.ndarray, "m 8"]
    clamped: Bool[np.ndarray, " nodes"]
    foundation: sp.csr_array
    _cell_of_grid: Int[np.ndarray, "n n n"] = field(repr=False)

    @classmethod
    def from_distance(cls, distance: Distance, cells: int = 24, clamp: Clamp | RigidClamp = _ON_THE_GROUND) -> Body:
        """Fill a grid of cells³ cells from a signed distance function, and hold it.

        Raises:
            BodyError: nothing is inside (`empty`), nothing or too little touches the support plane (`not_standing`) or
                the clamp's region (`clamp_off_body`), or a part is not connected to what is held (`disconnected`).
        """
        sampled = SampledDistance.of(distance, cells)
        return cls.from_fill(sampled, sampled.octant_fill, clamp)

    @classmethod
    def from_fill(
        cls, distance: Distance, fill: Float64[np.ndarray, "n2 n2 n2"], clamp: Clamp | RigidClamp = _ON_THE_GROUND
    ) -> Body:
        """Number the nodes of a grid of octant fill fractions with two octants along each edge of a cell."""
        n = fill.shape[0] // 2
        octants = fill.reshape(n, 2, n, 2, n, 2).transpose(0, 2, 4, 1, 3, 5).reshape(n, n, n, 8)
        solid = octants.mean(axis=3) >= MIN_FILL
        if not solid.any():
            raise BodyError("empty", "no cell holds material: the shape lies outside the cube or is too thin")
        hold = _Hold.of(clamp, distance, n)
        # islands that touch the rest only along an edge or a corner, or not at all, are not held by anything
        labels, count = ndimage.label(solid)
        held = np.unique(labels[hold.cells & solid])
        if len(held) == 0:
            raise hold.error("no part of the shape does")
        if count > len(held):
            kept = np.isin(labels, held)
            lost = float(octants[solid & ~kept].sum() / octants[solid].sum())
            if lost > 0.01:
                raise BodyError("disconnected", f"{lost:.0%} of the shape is not connected to what is held")
            solid = kept
        active = np.argwhere(solid)
        corners = active[:, None, :] + CORNERS[None]
        flat = np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), (n + 1,) * 3)
        used, cell_nodes = np.unique(flat, return_inverse=True)
        cell_of_grid = np.full((n, n, n), -1)
        cell_of_grid[solid] = np.arange(len(active))
        node_grid = np.stack(np.unravel_index(used, (n + 1,) * 3), axis=1)
        cell_nodes = cell_nodes.reshape(-1, 8)
        return cls(
            distance=distance,
            cells=n,
            active=active,
            octant_fill=octants[solid].T.astype(np.float64),
            node_grid=node_grid,
            cell_nodes=cell_nodes,
            clamped=hold.clamped(node_grid),
            foundation=hold.foundation(cell_of_grid, cell_nodes, len(used)),
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

    @cached_property
    def skin(self) -> tuple[Skin, Int[np.ndarray, " n"], Float64[np.ndarray, "n 3"]] | None:
        """Points all over the surface with the cell of each, see `settle`; None where the shape was not sampled."""
        if not isinstance(self.distance, SampledDistance) or self.distance.cells != self.cells:
            return None
        skin = Skin.of(self.distance)
        return skin, *self.settle(skin.points, skin.normals)

    @cached_property
    def solid_nodes(self) -> Int[np.ndarray, " n"]:
        """Nodes of cells that are at least half full: those of nearly empty ones move wildly."""
        return np.unique(self.cell_nodes[self.fill >= 0.5])

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

    @cached_property
    def foundation_values(self) -> Float64[np.ndarray, " nonzeros"]:
        """The foundation on the entries of `pattern`."""
        return self.pattern.spread(self.foundation, self.clamped)

    def locate(self, points: Float64[np.ndarray, "n 3"]) -> tuple[Int[np.ndarray, " n"], Float64[np.ndarray, "n 3"]]:
        """Active cell of each point (−1 where there is none) and its local coordinates in [0, 1]³."""
        return locate(points, self._cell_of_grid)

    def settle(
        self, points: Float64[np.ndarray, "n 3"], normals: Float64[np.ndarray, "n 3"]
    ) -> tuple[Int[np.ndarray, " n"], Float64[np.ndarray, "n 3"]]:
        """As `locate`, for points on the surface with outward normals, each moved inwards to an active cell."""
        return settle(points, normals, self._cell_of_grid)

    def gather(self, nodal: Float64[np.ndarray, "nodes 3"]) -> Float64[np.ndarray, "24 m"]:
        """Nodal vectors in element order, cells last."""
        element = np.empty((24, len(self.cell_nodes)))
        gather(nodal, self.cell_nodes, element)
        return element

    def scatter(self, element: Float64[np.ndarray, "24 m"]) -> Float64[np.ndarray, "nodes 3"]:
        """Sum element vectors into nodal ones."""
        nodal = np.zeros((self.nodes, 3))
        scatter(element, self.cell_nodes, nodal)
        return nodal

    def clamp_forces(
        self, displacements: Float64[np.ndarray, "nodes 3"], unbalanced: Float64[np.ndarray, "nodes 3"]
    ) -> Float64[np.ndarray, "nodes 3"]:
        """Nodal forces of the clamp on the body.

        Args:
            displacements: Of all nodes.
            unbalanced: Internal less applied forces; what they are at rigid nodes is the clamp's doing.
        """
        return np.asarray(np.where(self.clamped[:, None], unbalanced, -(self.foundation @ displacements)))

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


@dataclass(frozen=True)
class _Hold:
    """A clamp on a grid of n³ cells: the cells it touches, and what it adds to their nodes."""

    clamp: Clamp | RigidClamp
    distance: Distance
    cells: Bool[np.ndarray, "n n n"]
    bed: Bed

    @classmethod
    def of(cls, clamp: Clamp | RigidClamp, distance: Distance, n: int) -> _Hold:
        touched = np.zeros((n, n, n), bool)
        if isinstance(clamp, Clamp):
            bed = clamp.bed(distance, n)
            for depth in DEPTHS:
                index = np.floor(bed.points * n - depth * bed.normals).astype(np.int64)
                touched[tuple(np.clip(index, 0, n - 1).T)] = True
        else:
            bed = Bed(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))
            plane = np.stack(np.meshgrid(np.arange(n + 1), np.arange(n + 1), [0], indexing="ij"), axis=-1)
            ground = clamp.nodes(distance, plane.reshape(-1, 3), n).reshape(n + 1, n + 1)
            touched[:, :, 0] = ground[:-1, :-1] | ground[1:, :-1] | ground[:-1, 1:] | ground[1:, 1:]
        return cls(clamp, distance, touched, bed)

    def clamped(self, node_grid: Int[np.ndarray, "nodes 3"]) -> Bool[np.ndarray, " nodes"]:
        if isinstance(self.clamp, Clamp):
            return np.zeros(len(node_grid), bool)
        held = self.clamp.nodes(self.distance, node_grid, len(self.cells))
        if held.sum() < 3:
            raise self.error("fewer than three nodes do")
        return held

    def foundation(
        self, cell_of_grid: Int[np.ndarray, "n n n"], cell_nodes: Int[np.ndarray, "m 8"], nodes: int
    ) -> sp.csr_array:
        cell, local = settle(self.bed.points, self.bed.normals, cell_of_grid)
        good = cell >= 0
        if isinstance(self.clamp, Clamp) and not self.bed.only(good).holds:
            raise self.error("too little of the shape does to keep it from turning")
        shape = shape_functions(local[good])
        touched, group = np.unique(cell[good], return_inverse=True)
        blocks = np.zeros((len(touched), 8, 8))
        _add_products(shape, self.bed.stiffness[good], group, blocks)
        row = np.repeat(cell_nodes[touched], 8, axis=1).ravel()
        column = np.tile(cell_nodes[touched], (1, 8)).ravel()
        return sp.coo_array((blocks.ravel(), (row, column)), shape=(nodes, nodes)).tocsr()

    def error(self, what: str) -> BodyError:
        if isinstance(self.clamp, Clamp) and self.clamp.region is not None:
            return BodyError("clamp_off_body", f"the clamp's region must hold a patch of the surface: {what}")
        return BodyError("not_standing", f"the shape must touch the support plane z = 0: {what}")


@compiled
def _add_products(
    shape: Float64[np.ndarray, "n 8"],
    stiffness: Float64[np.ndarray, " n"],
    group: Int[np.ndarray, " n"],
    blocks: Float64[np.ndarray, "m 8 8"],
) -> None:
    """Add the stiffness of every point times the products of two shape functions to the block of its group."""
    for row in range(len(shape)):
        for a in range(8):
            part = stiffness[row] * shape[row, a]
            for b in range(8):
                blocks[group[row], a, b] += part * shape[row, b]
