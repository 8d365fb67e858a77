"""From nodal displacements to 64³ voxels, by inverting the map of every deformed cell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int, UInt8

from service.core.arrays import GRID_SIZE
from service.core.compiled import compiled
from training.simulation.body import Body
from training.simulation.inverse_map import material_points
from training.simulation.sampled import INSIDE, NEAR, OUTSIDE, SampledDistance
from training.simulation.trilinear import nodal_coefficients, value_at


@dataclass(frozen=True, eq=False)
class Rasterised:
    """A deformed body on a grid of size³ voxels, voxel (i, j, k) centred at ((i+½), (j+½), (k+½))/size.

    Displacements are in units of L. They are kept at the voxels that have one, and spread over the grid when asked for.

    Attributes:
        deformed: Which voxel centres lie in the deformed body.
        deformed_at: Places in the flat grid of these voxels, cell by cell of the body.
        moved_here: u(y) at these: the material point now at y was at y − u.
        at_rest: Places in the flat grid of the voxels of the body at rest.
        moved_from: u(x) at these.
        peak_displacement: Largest length of the forward field, that is, inside the body.
    """

    deformed: Bool[np.ndarray, "x y z"]
    deformed_at: Int[np.ndarray, " n"]
    moved_here: Float32[np.ndarray, "n 3"]
    at_rest: Int[np.ndarray, " k"]
    moved_from: Float32[np.ndarray, "k 3"]
    peak_displacement: float

    @cached_property
    def backward(self) -> Float32[np.ndarray, "3 x y z"]:
        """u(y) at every voxel centre y of the deformed body; NaN outside."""
        return self._spread(self.deformed_at, self.moved_here)

    @cached_property
    def forward(self) -> Float32[np.ndarray, "3 x y z"]:
        """u(x) at every voxel centre x of the body at rest; NaN outside."""
        return self._spread(self.at_rest, self.moved_from)

    def _spread(
        self, index: Int[np.ndarray, " n"], values: Float32[np.ndarray, "n 3"]
    ) -> Float32[np.ndarray, "3 x y z"]:
        field = np.full((3, self.deformed.size), np.nan, np.float32)
        field[:, index] = values.T
        return field.reshape(3, *self.deformed.shape)


class Rasteriser:
    """Voxelises the states of one body, one after the other; what depends only on its rest shape is computed once.

    Args:
        body: The body.
        size: Voxels along each edge of the cube.

    Attributes:
        rest: The body at rest.
    """

    def __init__(self, body: Body, size: int = GRID_SIZE) -> None:
        self.body = body
        self.size = size
        self._distance = SampledDistance.on(body.distance, body.cells)
        centres = voxel_centres(size)
        self.rest: Bool[np.ndarray, "x y z"] = self._distance.inside(centres).reshape((size,) * 3)
        index = np.flatnonzero(self.rest)
        cell, local = body.locate(centres[index].astype(np.float64))
        # cell by cell, so that the nodes of each are read once
        order = np.argsort(cell, kind="stable")[int((cell < 0).sum()) :]
        self._at_rest = index[order]
        self._rest_cell = cell[order]
        self._rest_local = (local[order] - 0.5).astype(np.float32)
        self._rest_cells, first = np.unique(self._rest_cell, return_index=True)
        self._rest_first = np.append(first, len(order))
        self._octants = self._distance.octants_of(body.active)
        # taken once: a voxel is found at most twice, see `material_points`
        self._place = np.empty(2 * size**3, np.int64)
        self._moved = np.empty((2 * size**3, 3), np.float32)
        self._asked = np.empty(size**3, np.int64)
        self._material = np.empty((size**3, 3), np.float32)

    def __call__(self, displacement: Float64[np.ndarray, "nodes 3"]) -> Rasterised:
        """Voxelise the body displaced at its nodes."""
        side, count, doubtful = self._sides(displacement, cautious=True)
        inside = self._distance(self._material[:doubtful]) < 0
        count = _decide(self._asked[:doubtful], inside, side, self._place, self._moved, count)
        forward = np.empty((len(self._at_rest), 3), np.float32)
        peak = _interpolate(
            displacement, self.body.cell_nodes, self._rest_cells, self._rest_first, self._rest_local, forward
        )
        return Rasterised(
            deformed=side.view(bool).reshape((self.size,) * 3),
            deformed_at=self._place[:count].copy(),
            moved_here=self._moved[:count].copy(),
            at_rest=self._at_rest,
            moved_from=forward,
            peak_displacement=peak,
        )

    def at_rest(self, values: Float64[np.ndarray, " cells"]) -> Float64[np.ndarray, " k"]:
        """What cells hold, at the voxels of the body at rest, in the order of `Rasterised.at_rest`."""
        return np.asarray(values[self._rest_cell])

    def occupancy(self, displacement: Float64[np.ndarray, "nodes 3"]) -> Bool[np.ndarray, "x y z"]:
        """Only the deformed occupancy, by interpolated distances: off by 0.1 % of the volume where edges are sharp."""
        return self._sides(displacement, cautious=False)[0].view(bool).reshape((self.size,) * 3)

    def _sides(
        self, displacement: Float64[np.ndarray, "nodes 3"], cautious: bool
    ) -> tuple[UInt8[np.ndarray, " voxels"], int, int]:
        body, sampled = self.body, self._distance
        side = np.zeros(self.size**3, np.uint8)
        count, doubtful = material_points(
            (body.node_positions + displacement) * self.size - 0.5, body.cell_nodes, body.active, body.cells,
            self._octants, sampled.polynomial, sampled.doubt, sampled.plane, cautious, self.size, side, self._place,
            self._moved, self._asked, self._material,
        )  # fmt: skip
        return side, count, doubtful


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
def _decide(
    asked: Int[np.ndarray, " m"],
    inside: Bool[np.ndarray, " m"],
    side: UInt8[np.ndarray, " voxels"],
    place: Int[np.ndarray, " rows"],
    moved: Float32[np.ndarray, "rows 3"],
    count: int,
) -> int:
    """Keep the rows asked about that lie inside and that no other cell was sure of; returns how many rows are left."""
    # from the end: what fills a gap, the last row, is one that stays
    for question in range(len(asked) - 1, -1, -1):
        row = asked[question]
        voxel = place[row]
        doubtful = side[voxel] == NEAR
        if doubtful:
            side[voxel] = INSIDE if inside[question] else OUTSIDE
        if not (doubtful and inside[question]):
            count -= 1
            place[row] = place[count]
            moved[row, 0], moved[row, 1], moved[row, 2] = moved[count, 0], moved[count, 1], moved[count, 2]
    return count


@compiled
def _interpolate(
    nodal: Float64[np.ndarray, "nodes 3"],
    cell_nodes: Int[np.ndarray, "m 8"],
    cells: Int[np.ndarray, " groups"],
    first: Int[np.ndarray, " groups+1"],
    local: Float32[np.ndarray, "n 3"],
    field: Float32[np.ndarray, "n 3"],
) -> float:
    """Write the trilinear nodal field at points grouped by cell, given from its middle; returns its largest length."""
    largest = 0.0
    for group in range(len(cells)):
        p = nodal_coefficients(nodal, cell_nodes, cells[group], 0)
        q = nodal_coefficients(nodal, cell_nodes, cells[group], 1)
        r = nodal_coefficients(nodal, cell_nodes, cells[group], 2)
        for row in range(first[group], first[group + 1]):
            x, y, z = local[row, 0], local[row, 1], local[row, 2]
            u, v, w = value_at(p, x, y, z), value_at(q, x, y, z), value_at(r, x, y, z)
            field[row, 0], field[row, 1], field[row, 2] = u, v, w
            largest = max(largest, u * u + v * v + w * w)
    return float(np.sqrt(largest))
