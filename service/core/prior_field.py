"""From the nodal displacements of a coarse solve to fields on the 32³ lattice that the network works on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int

from service.core.prior_grid import POINTS_27, CellGrid, shape_functions
from service.core.prior_rotation import Cofactors

FIELD_SIZE = 32
"""Nodes of the lattice along each edge; node i lies at (i + ½)/32."""

_SPLAT_SIZE = 16
_COARSE_SIZE = 4
_PARENT_SHARE = 0.01
"""What the coarser level counts for where the finer one has samples of its own; elsewhere it counts for all."""
_VOID_SHARE = 0.02
"""What a sample counts for that stands for no material: it continues the field around the body."""
_MIN_DETERMINANT = 0.1
_TOGETHER = 4
"""Loads treated at once: what they take up then stays in the cache, and memory is asked for but once."""

_SHAPE_27: Float32[np.ndarray, "27 8"] = np.ascontiguousarray(shape_functions(POINTS_27.T).T, np.float32)
_FULL_27 = np.outer(np.outer([5.0, 8.0, 5.0], [5.0, 8.0, 5.0]), [5.0, 8.0, 5.0]).ravel() / 18.0**3

Fields = Float32[np.ndarray, "loads axis=3 x=32 y=32 z=32"]
OfPoints = Float32[np.ndarray, "... loads 27 m"]


def backward_fields(
    grid: CellGrid, displacement: Float32[np.ndarray, "3 loads n"], gradient: Float32[np.ndarray, "3 3 loads m"]
) -> Fields:
    """u_b(y), with y − u_b(y) the material point at rest that lies at y after the load, for every load.

    27 points of every cell are carried forward, each with the first-order expansion of the backward field around it,
    ∇u_b = I − F⁻¹; the cells of a lattice of 16³ average the expansions that fall into them at their centres, and are
    completed by those of a lattice of 4³ where there are few; in between the centres the field is interpolated. No
    iteration is needed, whatever the rotation. Outside the deformed body the field continues smoothly.

    Args:
        grid: Cells of the body.
        displacement: Displacement of every node.
        gradient: F at the centre of every cell.
    """
    loads = displacement.shape[1]
    result = np.empty((loads, 3, FIELD_SIZE, FIELD_SIZE, FIELD_SIZE), np.float32)
    for first in range(0, loads, _TOGETHER):
        some = slice(first, first + _TOGETHER)
        points = _Points.carried(grid, displacement[:, some], gradient[:, :, some])
        weight, value = points.sums()
        value += np.float32(_PARENT_SHARE) * points.coarse().at_centres()
        value /= weight + np.float32(_PARENT_SHARE)
        _refine(value.transpose(1, 0, 2), out=result[some])
    return result


@dataclass(frozen=True, eq=False)
class _Points:
    """Points of the cells carried by their loads; points of a cell before cells: long inner loops.

    Attributes:
        index: Cell of the lattice that each lies in, along every axis.
        share: Material that each stands for.
        constant: Its expansion of the backward field at the origin.
        slope: ∇u_b of the cells.
    """

    index: Int[np.ndarray, "3 loads 27 m"]
    share: Float32[np.ndarray, "27 m"]
    constant: Float32[np.ndarray, "3 loads 27 m"]
    slope: Float32[np.ndarray, "3 3 loads m"]

    @classmethod
    def carried(
        cls,
        grid: CellGrid,
        displacement: Float32[np.ndarray, "3 loads n"],
        gradient: Float32[np.ndarray, "3 3 loads m"],
    ) -> _Points:
        moved = np.matmul(_SHAPE_27, np.take(displacement, grid.cell_nodes.T, axis=2))
        offset = grid.low[:, None] + grid.cells.T * grid.edges[:, None]
        rest = (offset[:, None] + (POINTS_27 * grid.edges).T[:, :, None]).astype(np.float32)
        place = moved + rest[:, None]
        index = (place * np.float32(_SPLAT_SIZE)).astype(np.int32)  # towards zero, which the clip makes the floor
        np.clip(index, 0, _SPLAT_SIZE - 1, out=index)
        slope = _slope(gradient)
        moved -= _times(slope, place)
        share = np.maximum(grid.weights / _FULL_27[:, None], 0.0).astype(np.float32) + np.float32(_VOID_SHARE)
        return cls(index, share, moved, slope)

    def sums(self) -> tuple[Float32[np.ndarray, "loads cells"], Float32[np.ndarray, "3 loads cells"]]:
        """Sum of the shares in each cell of the lattice, and of the expansions at its centre times these."""
        centre = (self.index.astype(np.float32) + np.float32(0.5)) * np.float32(1.0 / _SPLAT_SIZE)
        value = _times(self.slope, centre)
        value += self.constant
        value *= self.share
        place = _flat(self.index, _SPLAT_SIZE)
        share = np.broadcast_to(self.share, place.shape)
        return _summed(place, share, _SPLAT_SIZE**3), np.stack([_summed(place, v, _SPLAT_SIZE**3) for v in value])

    def coarse(self) -> _Coarse:
        """Mean expansions on the coarse lattice; where they are few the mean of all shows through."""
        _, loads, _, m = self.index.shape
        bins = _COARSE_SIZE**3
        place = _flat(self.index >> 2, _COARSE_SIZE)
        share = np.broadcast_to(self.share, place.shape)
        # all points of a cell have one slope: its sums over the cells of the lattice are a matrix product
        shares = _summed(place * m + np.arange(m), share, bins * m).reshape(loads, bins, m)
        slope = (shares @ self.slope.reshape(9, loads, m).transpose(1, 2, 0)).transpose(2, 0, 1)
        constant = [_summed(place, v, bins) for v in self.constant * self.share]
        total = np.concatenate([shares.sum(axis=2)[None], constant, slope])  # (13, loads, bins)
        total += np.float32(_PARENT_SHARE) * total.mean(axis=2, keepdims=True)
        total[1:] /= total[:1]
        shape = (loads, _COARSE_SIZE, _COARSE_SIZE, _COARSE_SIZE)
        return _Coarse(total[1:4].reshape(3, *shape), total[4:].reshape(3, 3, *shape))


@dataclass(frozen=True, eq=False)
class _Coarse:
    """Linear expansions of the backward field about the origin on the coarse lattice."""

    constant: Float32[np.ndarray, "3 loads x y z"]
    slope: Float32[np.ndarray, "3 3 loads x y z"]

    def at_centres(self) -> Float32[np.ndarray, "3 loads cells"]:
        """Interpolated between centres of the coarse lattice and evaluated at those of the fine one.

        Interpolation and the product with one coordinate are one table, [T, y T], to an axis.
        """
        _, loads, *_ = self.constant.shape
        along_z = np.concatenate([self.constant, self.slope[:, 2]], axis=4) @ _EVALUATION.T
        slope_z = self.slope[:, :2] @ _SPREADING.T
        along_y = _EVALUATION @ np.concatenate([along_z, slope_z[:, 1]], axis=3)
        slope_y = _SPREADING @ slope_z[:, 0]
        rows = np.concatenate([along_y, slope_y], axis=2).reshape(3, loads, 2 * _COARSE_SIZE, _SPLAT_SIZE**2)
        return np.asarray((_EVALUATION @ rows).reshape(3, loads, _SPLAT_SIZE**3))


def _slope(gradient: Float32[np.ndarray, "3 3 loads m"]) -> Float32[np.ndarray, "3 3 loads m"]:
    """I − F⁻¹ of every cell; the rate of change is left out where a cell is turned inside out."""
    cofactors = Cofactors(gradient)
    determinant = cofactors.update()
    good = determinant > _MIN_DETERMINANT
    slope = cofactors.values.swapaxes(0, 1) / np.where(good, -determinant, 1.0)
    for i in range(3):
        slope[i, i] += 1.0
    return np.asarray(slope * good, np.float32)


def _times(slope: Float32[np.ndarray, "3 3 loads m"], vectors: OfPoints) -> OfPoints:
    """The slope of each cell times a vector of each of its points."""
    result = slope[:, 0, :, None] * vectors[0]
    for j in (1, 2):
        result += slope[:, j, :, None] * vectors[j]
    return np.asarray(result)


def _flat(index: Int[np.ndarray, "3 loads 27 m"], size: int) -> Int[np.ndarray, "loads 27 m"]:
    """Number of the cell of a lattice, loads one behind the other."""
    flat = index[0] * size
    flat += index[1]
    flat *= size
    flat += index[2]
    return np.asarray(flat)


def _summed(
    place: Int[np.ndarray, "loads 27 m"], weights: Float32[np.ndarray, "loads 27 m"], bins: int
) -> Float32[np.ndarray, "loads bins"]:
    """Sums of weights in the bins of each load."""
    loads = len(place)
    index = place + (np.arange(loads) * bins)[:, None, None]
    sums = np.bincount(index.ravel(), weights=weights.ravel(), minlength=loads * bins)
    return sums.reshape(loads, bins).astype(np.float32)


def _refine(values: Float32[np.ndarray, "loads 3 cells"], out: Fields) -> None:
    """From the centres of the lattice to the nodes of the field; matrix products are faster than sums over strides."""
    loads, old, new = len(values), _SPLAT_SIZE, FIELD_SIZE
    along_z = values.reshape(-1, old) @ _TO_FIELD.T
    along_y = np.matmul(_TO_FIELD, along_z.reshape(-1, old, new))
    np.matmul(_TO_FIELD, along_y.reshape(-1, old, new * new), out=out.reshape(3 * loads, new, new * new))


def interpolation(coarse: int, fine: int, continued: bool) -> Float32[np.ndarray, "fine coarse"]:
    """Linear interpolation from the centres of `coarse` cells to those of `fine`; past the last continued or held."""
    place = (np.arange(fine) + 0.5) * coarse / fine - 0.5
    if not continued:
        place = np.clip(place, 0.0, coarse - 1.0)
    below = np.clip(np.floor(place).astype(int), 0, coarse - 2)
    table = np.zeros((fine, coarse), np.float32)
    table[np.arange(fine), below] = 1.0 - (place - below)
    table[np.arange(fine), below + 1] = place - below
    return table


_TO_FIELD = interpolation(_SPLAT_SIZE, FIELD_SIZE, continued=True)
_SPREADING = interpolation(_COARSE_SIZE, _SPLAT_SIZE, continued=False)
_EVALUATION = np.hstack(
    [_SPREADING, ((np.arange(_SPLAT_SIZE) + 0.5) / _SPLAT_SIZE).astype(np.float32)[:, None] * _SPREADING]
)
