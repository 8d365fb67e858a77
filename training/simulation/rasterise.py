"""From nodal displacements to 64³ voxels, by inverting the map of every deformed cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int

from service.core.arrays import GRID_SIZE
from training.simulation.body import Body
from training.simulation.elements import CORNERS, shape_functions

_ITERATIONS = 12
_TOLERANCE = 1e-3
"""Local coordinates are solved to this part of a cell, 1/400 of a voxel at 24³; voxels at a shared face are kept."""
_OUTSIDE = 0.75
"""Local coordinates, measured from the cell's centre, beyond which a voxel is given up as another cell's."""


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
    """

    def __init__(self, body: Body, size: int = GRID_SIZE) -> None:
        self.body = body
        self.size = size
        centres = voxel_centres(size)
        self.rest: Bool[np.ndarray, "x y z"] = (body.distance(centres) < 0).reshape((size,) * 3)
        index = np.flatnonzero(self.rest)
        cell, local = body.locate(centres[index].astype(np.float64))
        self._rest_index = index[cell >= 0]
        self._rest_cell = cell[cell >= 0]
        self._rest_shape = shape_functions(local[cell >= 0]).astype(np.float32)
        # a cell wholly inside needs no distance at its voxels
        self._partial = body.octant_fill.min(axis=0) < 1.0

    def __call__(self, displacement: Float64[np.ndarray, "nodes 3"]) -> Rasterised:
        """Voxelise the body displaced at its nodes."""
        index, rest = self._material_points(displacement)
        size = self.size
        deformed = np.zeros(size**3, bool)
        deformed[index] = True
        backward = np.full((3, size**3), np.nan, np.float32)
        place = np.stack(np.unravel_index(index, (size,) * 3)).astype(np.float32)
        backward[:, index] = (place + np.float32(0.5)) / np.float32(size) - rest.T
        forward = np.full((3, size**3), np.nan, np.float32)
        nodal = displacement.astype(np.float32)[self.body.cell_nodes[self._rest_cell]]
        moved = np.einsum("na,nai->in", self._rest_shape, nodal)
        forward[:, self._rest_index] = moved
        length = np.sqrt((moved**2).sum(axis=0))
        grid = (size,) * 3
        return Rasterised(
            deformed=deformed.reshape(grid),
            backward=backward.reshape(3, *grid),
            forward=forward.reshape(3, *grid),
            peak_displacement=float(length.max(initial=0.0)),
            mean_displacement=float(length.mean()) if length.size else 0.0,
        )

    def occupancy(self, displacement: Float64[np.ndarray, "nodes 3"]) -> Bool[np.ndarray, "x y z"]:
        """Only the deformed occupancy."""
        deformed = np.zeros(self.size**3, bool)
        deformed[self._material_points(displacement)[0]] = True
        return deformed.reshape((self.size,) * 3)

    def _material_points(
        self, displacement: Float64[np.ndarray, "nodes 3"]
    ) -> tuple[Int[np.ndarray, " n"], Float32[np.ndarray, "n 3"]]:
        """Flat index of every voxel in the deformed body, and the material point at rest that lies there."""
        body = self.body
        positions = ((body.node_positions + displacement) * self.size - 0.5).astype(np.float32)
        corners = positions[body.cell_nodes]
        voxel, cell = _candidates(corners, self.size)
        local, found = _invert(corners, voxel, cell)
        voxel, cell = voxel[found], cell[found]
        rest = (body.active[cell] + np.float32(0.5) + local[found]).astype(np.float32) * np.float32(body.cell_edge)
        inside = ~self._partial[cell]
        check = np.flatnonzero(~inside)
        inside[check] = body.distance(rest[check]) < 0
        flat = (voxel[inside, 0] * self.size + voxel[inside, 1]) * self.size + voxel[inside, 2]
        return flat, rest[inside]


def rasterise(body: Body, displacement: Float64[np.ndarray, "nodes 3"], size: int = GRID_SIZE) -> Rasterised:
    """Voxelise one state; use a `Rasteriser` for many states of one body."""
    return Rasteriser(body, size)(displacement)


def voxel_centres(size: int = GRID_SIZE) -> Float32[np.ndarray, "n 3"]:
    """Centres of size³ voxels of the unit cube, C order over [x, y, z]."""
    axis = (np.arange(size, dtype=np.float32) + np.float32(0.5)) / np.float32(size)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def _candidates(
    corners: Float32[np.ndarray, "m 8 3"], size: int
) -> tuple[Int[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Every voxel in the bounding box of every deformed cell; corners are in voxel indices."""
    low = np.clip(np.ceil(corners.min(axis=1) - _TOLERANCE), 0, size).astype(np.int32)
    high = np.clip(np.floor(corners.max(axis=1) + _TOLERANCE) + 1, 0, size).astype(np.int32)
    extent = np.maximum(high - low, 0)
    count = extent.prod(axis=1)
    cell = np.repeat(np.arange(len(corners)), count)
    rank = np.arange(len(cell)) - np.repeat(np.cumsum(count) - count, count)
    depth, width = extent[cell, 2], extent[cell, 1]
    rest, k = np.divmod(rank, depth)
    i, j = np.divmod(rest, width)
    return np.stack([i, j, k], axis=1) + low[cell], cell


def _invert(
    corners: Float32[np.ndarray, "m 8 3"], voxel: Int[np.ndarray, "n 3"], cell: Int[np.ndarray, " n"]
) -> tuple[Float32[np.ndarray, "n 3"], Bool[np.ndarray, " n"]]:
    """Local coordinates in [−½, ½]³ of voxels in their candidate cells, and which of them lie inside.

    The trilinear map is its value and Jacobian at the cell's centre plus four products of the local coordinates,
    y = c + A ξ + B (ξη, ηζ, ζξ, ξηζ). The fixed point ξ ← A⁻¹(y − c) − A⁻¹B(ξη, ηζ, ζξ, ξηζ) converges in a few steps
    because cells are small; voxels that run away belong to another cell.
    """
    sign = np.where(CORNERS == 1, 1.0, -1.0).astype(np.float32)
    products = _products(sign.T / 2)  # (4, 8) at the corners
    centre = corners.mean(axis=1)
    jacobian = np.einsum("mai,aj->mij", corners, sign) / 4
    bilinear = np.einsum("mai,pa->mip", corners, products * np.array([[2], [2], [2], [8]], np.float32))
    determinant = np.linalg.det(jacobian)
    usable = determinant > 1e-6
    inverse = np.zeros_like(jacobian)
    inverse[usable] = np.linalg.inv(jacobian[usable])
    curved = inverse @ bilinear
    # the largest shift that the products can make bounds how far outside the affine guess may lie
    margin = 0.5 + _TOLERANCE + np.abs(curved[:, :, :3]).sum(axis=2) / 4 + np.abs(curved[:, :, 3]) / 8
    offset = voxel.astype(np.float32) - centre[cell]
    start = np.einsum("nij,nj->ni", inverse[cell], offset)
    open_ = np.flatnonzero((np.abs(start) <= margin[cell]).all(axis=1) & usable[cell])
    local = np.zeros_like(start)
    found = np.zeros(len(start), bool)
    target = start[open_].T
    terms = curved[cell[open_]].transpose(1, 2, 0)  # (3, 4, n)
    current = target
    for _ in range(_ITERATIONS):
        value = target - (terms * _products(current)[None]).sum(axis=1)
        change = np.abs(value - current).max(axis=0)
        current = np.clip(value, -_OUTSIDE, _OUTSIDE)
        done = change < 0.5 * _TOLERANCE
        settled = open_[done]
        local[settled] = current[:, done].T
        found[settled] = True
        if done.all():
            break
        open_, target, terms, current = open_[~done], target[:, ~done], terms[:, :, ~done], current[:, ~done]
    found &= (np.abs(local) <= 0.5 + _TOLERANCE).all(axis=1)
    return local, found


def _products(local: Float32[np.ndarray, "3 n"]) -> Float32[np.ndarray, "4 n"]:
    xy = local[0] * local[1]
    return np.stack([xy, local[1] * local[2], local[2] * local[0], xy * local[2]])
