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
_MAX_CANDIDATES = 2_000_000
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
        backward[:, index] = (place + np.float32(0.5)) / np.float32(size) - rest
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
    ) -> tuple[Int[np.ndarray, " n"], Float32[np.ndarray, "3 n"]]:
        """Flat index of every voxel in the deformed body, and the material point at rest that lies there."""
        body = self.body
        positions = ((body.node_positions + displacement) * self.size - 0.5).astype(np.float32)
        voxel, cell, local = _invert(positions[body.cell_nodes], self.size)
        rest = (body.active.T[:, cell] + np.float32(0.5) + local).astype(np.float32) * np.float32(body.cell_edge)
        inside = ~self._partial[cell]
        check = np.flatnonzero(~inside)
        inside[check] = body.distance(np.ascontiguousarray(rest[:, check].T)) < 0
        return voxel[inside], rest[:, inside]


def rasterise(body: Body, displacement: Float64[np.ndarray, "nodes 3"], size: int = GRID_SIZE) -> Rasterised:
    """Voxelise one state; use a `Rasteriser` for many states of one body."""
    return Rasteriser(body, size)(displacement)


def voxel_centres(size: int = GRID_SIZE) -> Float32[np.ndarray, "n 3"]:
    """Centres of size³ voxels of the unit cube, C order over [x, y, z]."""
    axis = (np.arange(size, dtype=np.float32) + np.float32(0.5)) / np.float32(size)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def _invert(
    corners: Float32[np.ndarray, "m 8 3"], size: int
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Float32[np.ndarray, "3 n"]]:
    """Every voxel centre in every deformed cell: flat voxel index, cell, local coordinates in [−½, ½]³.

    The trilinear map is its value and Jacobian at the cell's centre plus four products of the local coordinates,
    y = c + A ξ + B (ξη, ηζ, ζξ, ξηζ). The fixed point ξ ← A⁻¹(y − c) − A⁻¹B(ξη, ηζ, ζξ, ξηζ) converges in a few steps
    because cells are small; voxels that run away belong to another cell.

    Args:
        corners: Deformed corners of every cell, in voxel indices.
        size: Voxels along each edge of the grid.
    """
    sign = np.where(CORNERS == 1, 1.0, -1.0).astype(np.float32)
    signed_products = _products(sign.T)
    centre = corners.mean(axis=1)
    # at the corners ξ = ±½, so that a coefficient of two factors is 4 times the mean of its signs, of three 8 times
    coefficients = np.concatenate([2 * sign.T, 4 * signed_products[:3], 8 * signed_products[3:]]) / 8
    terms = (coefficients.astype(np.float32) @ corners).transpose(0, 2, 1)
    jacobian, bilinear = terms[:, :, :3], terms[:, :, 3:]
    # a cell turned inside out has no inverse; states that hold one are reported by the solver
    usable = np.linalg.det(jacobian) > 1e-6
    inverse = np.zeros_like(jacobian)
    inverse[usable] = np.linalg.inv(jacobian[usable])
    curved = inverse @ bilinear
    # the largest shift that the products can make bounds how far outside the affine guess may lie
    margin = 0.5 + _TOLERANCE + np.abs(curved[:, :, :3]).sum(axis=2) / 4 + np.abs(curved[:, :, 3]) / 8
    low = np.clip(np.ceil(corners.min(axis=1) - _TOLERANCE), 0, size).astype(np.int64)
    high = np.clip(np.floor(corners.max(axis=1) + _TOLERANCE) + 1, 0, size).astype(np.int64)
    extent = np.where((high > low).all(axis=1) & usable, (high - low).max(axis=1), 0)
    first = np.einsum("mij,mj->mi", inverse, low - centre)
    parts = [(np.empty((3, 0), np.int64), np.empty(0, np.int64), np.empty((3, 0), np.float32))]
    for edge in np.unique(extent[extent > 0]):
        cells = np.flatnonzero(extent == edge)
        # a cell torn over half the grid is rare, but many of them at once would not fit into memory
        for block in np.array_split(cells, 1 + len(cells) * int(edge) ** 3 // _MAX_CANDIDATES):
            parts.append(_affine_candidates(block, int(edge), low, first, inverse, margin))
    voxel = np.concatenate([part[0] for part in parts], axis=1)
    cell = np.concatenate([part[1] for part in parts])
    start = np.concatenate([part[2] for part in parts], axis=1)
    local, settled = _fixed_point(start, curved[cell].transpose(1, 2, 0))
    settled &= (np.abs(local).max(axis=0) <= 0.5 + _TOLERANCE) & (voxel.min(axis=0) >= 0) & (voxel.max(axis=0) < size)
    voxel = voxel[:, settled]
    return (voxel[0] * size + voxel[1]) * size + voxel[2], cell[settled], local[:, settled]


def _affine_candidates(
    cells: Int[np.ndarray, " c"],
    edge: int,
    low: Int[np.ndarray, "m 3"],
    first: Float64[np.ndarray, "m 3"],
    inverse: Float32[np.ndarray, "m 3 3"],
    margin: Float32[np.ndarray, "m 3"],
) -> tuple[Int[np.ndarray, "3 n"], Int[np.ndarray, " n"], Float32[np.ndarray, "3 n"]]:
    """Voxels of the bounding boxes, edge³ voxels each, that may lie in their cell by its affine part.

    Returns:
        Voxel index, cell, and the affine guess of the local coordinates.
    """
    axis = np.arange(edge)
    offsets = np.stack(np.meshgrid(axis, axis, axis, indexing="ij")).reshape(3, -1)
    guess = inverse[cells] @ offsets.astype(np.float32)
    guess += first[cells, :, None].astype(np.float32)
    bound = margin[cells].astype(np.float32)
    maybe = np.abs(guess[:, 0]) <= bound[:, :1]
    for component in (1, 2):
        maybe &= np.abs(guess[:, component]) <= bound[:, component, None]
    row, place = np.nonzero(maybe)
    cell = cells[row]
    return low.T[:, cell] + offsets[:, place], cell, np.stack([guess[row, i, place] for i in range(3)])


def _fixed_point(
    start: Float32[np.ndarray, "3 n"], terms: Float32[np.ndarray, "3 4 n"]
) -> tuple[Float32[np.ndarray, "3 n"], Bool[np.ndarray, " n"]]:
    """Local coordinates that solve the trilinear map, and which of them converged."""
    local = start.copy()
    settled = np.zeros(start.shape[1], bool)
    open_ = np.arange(start.shape[1])
    target, current = start, start
    for _ in range(_ITERATIONS):
        value = target - np.einsum("ipn,pn->in", terms, _products(current))
        change = np.abs(value - current).max(axis=0)
        np.clip(value, -_OUTSIDE, _OUTSIDE, out=value)
        local[:, open_] = value
        going = change >= 0.5 * _TOLERANCE
        settled[open_[~going]] = True
        open_ = open_[going]
        if len(open_) == 0:
            break
        target, current, terms = target[:, going], value[:, going], terms[:, :, going]
    return local, settled


def _products(local: Float32[np.ndarray, "3 n"]) -> Float32[np.ndarray, "4 n"]:
    xy = local[0] * local[1]
    return np.stack([xy, local[1] * local[2], local[2] * local[0], xy * local[2]])
