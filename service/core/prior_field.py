"""From the nodal displacements of a coarse solve to fields on the 32³ lattice that the network works on."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled
from service.core.prior_cells import Cells, Nodal, at_corners, gradients
from service.core.prior_grid import POINTS_27, CellGrid, shape_functions
from service.core.prior_rotation import Matrices, add_identity, cofactors

FIELD_SIZE = 32
"""Nodes of the lattice along each edge; node i lies at (i + ½)/32."""

_SPLAT_SIZE = 16
_COARSE_SIZE = 4
_PARENT_SHARE = 0.01
"""What the coarser level counts for where the finer one has samples of its own; elsewhere it counts for all."""
_VOID_SHARE = 0.02
"""What a sample counts for that stands for no material: it continues the field around the body."""
_MIN_DETERMINANT = np.float32(0.1)
_SHAPE_27: Float32[np.ndarray, "27 8"] = np.ascontiguousarray(shape_functions(POINTS_27.T).T, np.float32)
_FULL_27 = np.outer(np.outer([5.0, 8.0, 5.0], [5.0, 8.0, 5.0]), [5.0, 8.0, 5.0]).ravel() / 18.0**3

Fields = Float32[np.ndarray, "loads axis=3 x=32 y=32 z=32"]
Sums = Float32[np.ndarray, "bins sums"]


class Points(NamedTuple):
    """27 points of every cell, their places at rest and the material that each stands for."""

    place: Float32[np.ndarray, "27 3 m"]
    share: Float32[np.ndarray, "27 m"]

    @classmethod
    def of(cls, grid: CellGrid) -> Points:
        """Those of Gauss's rule in the cells of a grid."""
        offset = grid.low[:, None] + grid.cells.T * grid.edges[:, None]
        place = offset + (POINTS_27 * grid.edges)[:, :, None]
        share = np.maximum(grid.weights / _FULL_27[:, None], 0.0) + _VOID_SHARE
        return cls(place.astype(np.float32), share.astype(np.float32))


def backward_fields(points: Points, cells: Cells, displacement: Float32[np.ndarray, "loads 3 n"]) -> Fields:
    """u_b(y), with y − u_b(y) the material point at rest that lies at y after the load, for every load.

    27 points of every cell are carried forward, each with the first-order expansion of the backward field around it,
    ∇u_b = I − F⁻¹; the cells of a lattice of 16³ average the expansions that fall into them at their centres, and are
    completed by those of a lattice of 4³ where there are few; in between the centres the field is interpolated. No
    iteration is needed, whatever the rotation. Outside the deformed body the field continues smoothly.

    Args:
        points: Of the body.
        cells: Of the body.
        displacement: Displacement of every node.
    """
    loads = len(displacement)
    along_y = np.empty((3 * _SPLAT_SIZE, FIELD_SIZE, FIELD_SIZE), np.float32)
    result = np.empty((loads, 3, FIELD_SIZE, FIELD_SIZE, FIELD_SIZE), np.float32)
    for load in range(loads):
        fine = np.zeros((_SPLAT_SIZE**3, 4), np.float32)
        coarse = np.zeros((_COARSE_SIZE**3, 13), np.float32)
        _splat(points, cells, displacement[load], fine, coarse)
        value = np.float32(_PARENT_SHARE) * _at_centres(coarse) + fine[:, 1:].T
        value /= fine[:, 0] + np.float32(_PARENT_SHARE)
        _refine(value, along_y, out=result[load])
    return result


@compiled
def _splat(points: Points, cells: Cells, displacement: Nodal, fine: Sums, coarse: Sums) -> None:
    """Add the points, carried by the displacement, to the lattice cells that they fall into.

    Args:
        points: Of the body.
        cells: Of the body.
        displacement: Of the nodes.
        fine: Sums of the shares, and of the expansions at the centre of the lattice cell times these.
        coarse: Sums of the shares, and of the expansions about the origin, constants and slopes, times these.
    """
    k = cells.nodes.shape[1]
    corners, slope = np.empty((8, 3, k), np.float32), np.empty((3, 3, k), np.float32)
    moved = np.empty((3, k), np.float32)
    at_corners(cells, displacement, corners)
    gradients(cells, corners, slope)
    add_identity(slope)
    _backward_slopes(slope)
    for q in range(len(points.share)):
        for i in range(len(moved)):
            row = moved[i]
            row[:] = 0.0
            for a in range(len(corners)):
                corner, shape = corners[a, i], _SHAPE_27[q, a]
                for c in range(k):
                    row[c] += shape * corner[c]
        for c in range(cells.own):
            x, y, z = moved[0, c], moved[1, c], moved[2, c]
            share = points.share[q, c]
            at_x, at_y, at_z = points.place[q, 0, c] + x, points.place[q, 1, c] + y, points.place[q, 2, c] + z
            index_x, index_y, index_z = _lattice_index(at_x), _lattice_index(at_y), _lattice_index(at_z)
            sums = coarse[((index_x >> 2) * _COARSE_SIZE + (index_y >> 2)) * _COARSE_SIZE + (index_z >> 2)]
            centre_x, centre_y, centre_z = _centre(index_x), _centre(index_y), _centre(index_z)
            own = fine[(index_x * _SPLAT_SIZE + index_y) * _SPLAT_SIZE + index_z]
            sums[0] += share
            own[0] += share
            for i in range(3):
                a, b, d = slope[i, 0, c], slope[i, 1, c], slope[i, 2, c]
                constant = moved[i, c] - (a * at_x + b * at_y + d * at_z)
                own[1 + i] += share * (constant + a * centre_x + b * centre_y + d * centre_z)
                sums[1 + i] += share * constant
                sums[4 + 3 * i] += share * a
                sums[5 + 3 * i] += share * b
                sums[6 + 3 * i] += share * d


@compiled
def _lattice_index(place: np.float32) -> int:
    return min(max(int(place * np.float32(_SPLAT_SIZE)), 0), _SPLAT_SIZE - 1)


@compiled
def _centre(index: int) -> np.float32:
    return (np.float32(index) + np.float32(0.5)) * np.float32(1.0 / _SPLAT_SIZE)


@compiled
def _backward_slopes(matrices: Matrices) -> None:
    """I − F⁻¹ in the place of F; the rate of change is left out where a cell is turned inside out."""
    one = np.float32(1.0)
    for k in range(matrices.shape[2]):
        a, b, c = matrices[0, 0, k], matrices[0, 1, k], matrices[0, 2, k]
        d, e, f = matrices[1, 0, k], matrices[1, 1, k], matrices[1, 2, k]
        g, h, i = matrices[2, 0, k], matrices[2, 1, k], matrices[2, 2, k]
        ca, cb, cc, cd, ce, cf, cg, ch, ci = cofactors(a, b, c, d, e, f, g, h, i)
        determinant = a * ca + b * cb + c * cc
        good = one if determinant > _MIN_DETERMINANT else np.float32(0.0)
        inverse = good / max(determinant, _MIN_DETERMINANT)
        matrices[0, 0, k], matrices[0, 1, k], matrices[0, 2, k] = good - inverse * ca, -inverse * cd, -inverse * cg
        matrices[1, 0, k], matrices[1, 1, k], matrices[1, 2, k] = -inverse * cb, good - inverse * ce, -inverse * ch
        matrices[2, 0, k], matrices[2, 1, k], matrices[2, 2, k] = -inverse * cc, -inverse * cf, good - inverse * ci


def _at_centres(sums: Sums) -> Float32[np.ndarray, "3 cells"]:
    """The coarse expansions, interpolated between centres of the coarse lattice and evaluated at those of the fine one.

    Where they are few the mean of all shows through. Interpolation and the product with one coordinate are one table,
    [T, y T], to an axis.
    """
    total = sums.T + np.float32(_PARENT_SHARE) * sums.mean(axis=0)[:, None]
    expansions = (total[1:] / total[0]).reshape(12, _COARSE_SIZE, _COARSE_SIZE, _COARSE_SIZE)
    constant, slope = expansions[:3], expansions[3:].reshape(3, 3, _COARSE_SIZE, _COARSE_SIZE, _COARSE_SIZE)
    along_z = np.concatenate([constant, slope[:, 2]], axis=3) @ _EVALUATION.T
    slope_z = slope[:, :2] @ _SPREADING.T
    along_y = _EVALUATION @ np.concatenate([along_z, slope_z[:, 1]], axis=2)
    slope_y = _SPREADING @ slope_z[:, 0]
    rows = np.concatenate([along_y, slope_y], axis=1).reshape(3, 2 * _COARSE_SIZE, _SPLAT_SIZE**2)
    return np.asarray((_EVALUATION @ rows).reshape(3, _SPLAT_SIZE**3))


def _refine(
    values: Float32[np.ndarray, "3 cells"],
    along_y: Float32[np.ndarray, "rows y z"],
    out: Float32[np.ndarray, "3 x y z"],
) -> None:
    """From the centres of the lattice to the nodes of the field; matrix products are faster than sums over strides.

    Args:
        values: At the centres.
        along_y: To be written over: memory asked for anew is slow.
        out: At the nodes.
    """
    old, new = _SPLAT_SIZE, FIELD_SIZE
    along_z = values.reshape(-1, old) @ _TO_FIELD.T
    np.matmul(_TO_FIELD, along_z.reshape(-1, old, new), out=along_y)
    np.matmul(_TO_FIELD, along_y.reshape(3, old, new * new), out=out.reshape(3, new, new * new))


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
