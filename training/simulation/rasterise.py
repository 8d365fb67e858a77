"""From nodal displacements to 64³ voxels, by inverting the map of every deformed cell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, UInt8

from service.core.arrays import GRID_SIZE
from training.simulation.body import Body
from training.simulation.compiled import compiled
from training.simulation.inverse_map import material_points
from training.simulation.sampled import INSIDE, NEAR, SampledDistance


@dataclass(frozen=True, eq=False)
class Rasterised:
    """A deformed body on a grid of size³ voxels, voxel (i, j, k) centred at ((i+½), (j+½), (k+½))/size.

    Attributes:
        deformed: Which voxel centres lie in the deformed body.
        backward: u(y) at every deformed voxel centre y, whose material point at rest is y − u; in units of L, axis
            first, NaN outside.
        forward: u(x) at every voxel centre x of the body at rest; NaN outside.
        peak_displacement: Largest length of the forward field, that is, inside the body.
        mean_displacement: Mean length of the forward field.
    """

    deformed: Bool[np.ndarray, "x y z"]
    backward: Float32[np.ndarray, "3 x y z"]
    forward: Float32[np.ndarray, "3 x y z"]
    peak_displacement: float
    mean_displacement: float


class Rasteriser:
    """Voxelises the states of one body; what depends only on its rest shape is computed once.

    Args:
        body: The body.
        size: Voxels along each edge of the cube.

    Attributes:
        rest: The body at rest.
        solid_nodes: Nodes of cells that are at least half full.
    """

    def __init__(self, body: Body, size: int = GRID_SIZE) -> None:
        self.body = body
        self.size = size
        self._distance = (
            body.distance
            if isinstance(body.distance, SampledDistance) and body.distance.cells == body.cells
            else SampledDistance.of(body.distance, body.cells)
        )
        self.solid_nodes: Int[np.ndarray, " n"] = np.unique(body.cell_nodes[body.fill >= 0.5])
        centres = voxel_centres(size)
        self.rest: Bool[np.ndarray, "x y z"] = self._distance.inside(centres).reshape((size,) * 3)
        index = np.flatnonzero(self.rest)
        cell, local = body.locate(centres[index].astype(np.float64))
        self._rest_index = index[cell >= 0]
        self._rest_cell = cell[cell >= 0]
        self._rest_local = local[cell >= 0].astype(np.float32)

    def __call__(self, displacement: Float64[np.ndarray, "nodes 3"]) -> Rasterised:
        """Voxelise the body displaced at its nodes."""
        grid = (self.size,) * 3
        backward = np.full((3, *grid), np.nan, np.float32)
        side = self._sides(displacement, backward)
        deformed = side == INSIDE
        asked = np.flatnonzero(side == NEAR)
        moved = backward.reshape(3, -1)
        held = self._distance(voxel_centres(self.size)[asked] - moved[:, asked].T) < 0
        deformed.reshape(-1)[asked] = held
        moved[:, asked[~held]] = np.nan
        forward = np.full((3, *grid), np.nan, np.float32)
        peak, total = _interpolate(
            displacement, self.body.cell_nodes, self._rest_index, self._rest_cell, self._rest_local,
            forward.reshape(3, -1),
        )  # fmt: skip
        return Rasterised(
            deformed=deformed,
            backward=backward,
            forward=forward,
            peak_displacement=peak,
            mean_displacement=total / max(len(self._rest_index), 1),
        )

    def occupancy(self, displacement: Float64[np.ndarray, "nodes 3"]) -> Bool[np.ndarray, "x y z"]:
        """Only the deformed occupancy, by interpolated distances: off by 0.1 % of the volume where edges are sharp."""
        return np.asarray(self._sides(displacement, np.empty((3, 0, 0, 0), np.float32)) == INSIDE)

    def _sides(
        self, displacement: Float64[np.ndarray, "nodes 3"], backward: Float32[np.ndarray, "3 _ _ _"]
    ) -> UInt8[np.ndarray, "x y z"]:
        body, sampled = self.body, self._distance
        side = np.zeros((self.size,) * 3, np.uint8)
        material_points(
            (body.node_positions + displacement) * self.size - 0.5, body.cell_nodes, body.active,
            sampled.state, sampled.lattice, sampled.doubt, side, backward,
        )  # fmt: skip
        return side


def rasterise(body: Body, displacement: Float64[np.ndarray, "nodes 3"], size: int = GRID_SIZE) -> Rasterised:
    """Voxelise one state; use a `Rasteriser` for many states of one body."""
    return Rasteriser(body, size)(displacement)


@cache
def voxel_centres(size: int = GRID_SIZE) -> Float32[np.ndarray, "n 3"]:
    """Centres of size³ voxels of the unit cube, C order over [x, y, z]; read-only."""
    axis = (np.arange(size, dtype=np.float32) + np.float32(0.5)) / np.float32(size)
    centres = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    centres.flags.writeable = False
    return centres


@compiled
def _interpolate(
    nodal: Float64[np.ndarray, "nodes 3"],
    cell_nodes: Int[np.ndarray, "m 8"],
    place: Int[np.ndarray, " n"],
    cell: Int[np.ndarray, " n"],
    local: Float32[np.ndarray, "n 3"],
    field: Float32[np.ndarray, "3 voxels"],
) -> tuple[float, float]:
    """Write the trilinear nodal field at points given by cell and local coordinates; its largest and total length."""
    peak, total = 0.0, 0.0
    for row in range(len(place)):
        x, y, z = local[row, 0], local[row, 1], local[row, 2]
        m = cell[row]
        length = 0.0
        for axis in range(3):
            # corner 4·dx + 2·dy + dz: halve along z, then y, then x
            a = nodal[cell_nodes[m, 0], axis] * (1 - z) + nodal[cell_nodes[m, 1], axis] * z
            b = nodal[cell_nodes[m, 2], axis] * (1 - z) + nodal[cell_nodes[m, 3], axis] * z
            c = nodal[cell_nodes[m, 4], axis] * (1 - z) + nodal[cell_nodes[m, 5], axis] * z
            d = nodal[cell_nodes[m, 6], axis] * (1 - z) + nodal[cell_nodes[m, 7], axis] * z
            value = (a * (1 - y) + b * y) * (1 - x) + (c * (1 - y) + d * y) * x
            field[axis, place[row]] = value
            length += value * value
        length = np.sqrt(length)
        peak = max(peak, length)
        total += length
    return peak, total
