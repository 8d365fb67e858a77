"""From the nodal displacements of a coarse solve to fields on the 32³ lattice that the network works on."""

from __future__ import annotations

from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled
from service.core.prior_cells import Cells, Nodal, at_corners, gradients
from service.core.prior_grid import CORNERS, CellGrid, shape_functions
from service.core.prior_interpolation import NewRows, Rows, interpolate
from service.core.prior_rotation import Matrices, add_identity, cofactors
from service.core.prior_sole import GAUSS_3

FIELD_SIZE = 32
"""Nodes of the lattice along each edge; node i lies at (i + ½)/32."""

_SPLAT_SIZE = 16
_COARSE_SIZE = 4
_PARENT_SHARE = 0.01
"""What the coarser level counts for where the finer one has samples of its own; elsewhere it counts for all."""
_VOID_SHARE = 0.02
"""What a sample counts for that stands for no material: it continues the field around the body."""
_HELD, _CONTINUED = np.float32(0.0), np.float32(1.0)
_MIN_DETERMINANT = np.float32(0.1)
_POINTS = np.stack(np.meshgrid(GAUSS_3, GAUSS_3, GAUSS_3, indexing="ij"), -1).reshape(-1, 3)
_SHAPE: Float32[np.ndarray, "27 8"] = np.ascontiguousarray(shape_functions(_POINTS.T).T, np.float32)
# a point on the border of octants stands for a part of each
_NEAR = 0.5 + np.sign(np.round(_POINTS[:, None] - 0.5, 6)) * (CORNERS - 0.5)
_PART_OF_OCTANT = (8.0 * _NEAR.prod(axis=2)).astype(np.float32)

Fields = Float32[np.ndarray, "loads axis=3 x=32 y=32 z=32"]
Sums = Float32[np.ndarray, "bins sums"]
Row = Float32[np.ndarray, " k"]


class Points(NamedTuple):
    """27 points of every cell at rest, and the material that each stands for."""

    corner: Float32[np.ndarray, "3 m"]
    offset: Float32[np.ndarray, "27 3"]
    share: Float32[np.ndarray, "27 m"]

    @classmethod
    def of(cls, grid: CellGrid) -> Points:
        """Those of Gauss's rule in the cells of a grid."""
        corner = (grid.low + grid.cells * grid.edges).T
        share = _PART_OF_OCTANT @ grid.octants + np.float32(_VOID_SHARE)
        return cls(np.ascontiguousarray(corner, np.float32), (_POINTS * grid.edges).astype(np.float32), share)


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
    loads, old, new = len(displacement), _SPLAT_SIZE, FIELD_SIZE
    fine, coarse = np.empty((old**3, 4), np.float32), np.empty((_COARSE_SIZE**3, 13), np.float32)
    value = np.empty((3, old**3), np.float32)
    along_z, along_y = np.empty((3 * old * old, new, 1), np.float32), np.empty((3 * old, new, new), np.float32)
    result = np.empty((loads, 3, new, new, new), np.float32)
    for load in range(loads):
        fine[...] = 0.0
        coarse[...] = 0.0
        _splat(points, cells, displacement[load], fine, coarse)
        _average(fine, coarse, value)
        _refine(value.reshape(-1, old, 1), _CONTINUED, along_z)
        _refine(along_z.reshape(-1, old, new), _CONTINUED, along_y)
        _refine(along_y.reshape(3, old, new * new), _CONTINUED, result[load].reshape(3, new, new * new))
    return result


def held(field: Float32[np.ndarray, "3 32 32 32"]) -> Float32[np.ndarray, "3 32 32 32"]:
    """A backward field in which nothing has moved farther than the place is high that it has come to.

    For solutions that do not balance: what droops to the floor in such a guess may be a wall that crumples, and the
    body is not to stand on it. In a balanced one it does droop, and is left.
    """
    height = ((np.arange(FIELD_SIZE) + 0.5) / FIELD_SIZE).astype(np.float32)
    length = np.sqrt(np.einsum("axyz,axyz->xyz", field, field))
    result: Float32[np.ndarray, "3 32 32 32"] = field * np.minimum(1.0, height / np.maximum(length, height))
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
                corner, shape = corners[a, i], _SHAPE[q, a]
                for c in range(k):
                    row[c] += shape * corner[c]
        for c in range(cells.own):
            x, y, z = moved[0, c], moved[1, c], moved[2, c]
            share = points.share[q, c]
            at_x = points.corner[0, c] + points.offset[q, 0] + x
            at_y = points.corner[1, c] + points.offset[q, 1] + y
            at_z = points.corner[2, c] + points.offset[q, 2] + z
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


@compiled
def _average(fine: Sums, coarse: Sums, result: Float32[np.ndarray, "3 cells"]) -> None:
    """Write the means at the centres of the fine lattice, completed by the coarse expansions where it has few samples.

    The expansions are interpolated between centres of the coarse lattice; where they are few the mean of all shows
    through.
    """
    few, count = np.float32(_PARENT_SHARE), len(coarse)
    expansions = np.empty((12, count), np.float32)
    for i in range(12):
        mean, mean_share = np.float32(0.0), np.float32(0.0)
        for c in range(count):
            mean += coarse[c, 1 + i]
            mean_share += coarse[c, 0]
        mean, mean_share = few * mean / np.float32(count), few * mean_share / np.float32(count)
        for c in range(count):
            expansions[i, c] = (coarse[c, 1 + i] + mean) / (coarse[c, 0] + mean_share)
    old, new = _COARSE_SIZE, _SPLAT_SIZE
    along_z, along_y = np.empty((12 * old * old, new, 1), np.float32), np.empty((12 * old, new, new), np.float32)
    spread = np.empty((12, new, new * new), np.float32)
    _refine(expansions.reshape(12 * old * old, old, 1), _HELD, along_z)
    _refine(along_z.reshape(12 * old, old, new), _HELD, along_y)
    _refine(along_y.reshape(12, old, new * new), _HELD, spread)
    at, own, to = spread.reshape(12, new * new, new), fine.reshape(new * new, new, 4), result.reshape(3, new * new, new)
    for row in range(new * new):
        _complete(at[:, row], _centre(row // new), _centre(row % new), own[row], to[0, row], to[1, row], to[2, row])


@partial(compiled, apart=True)
def _complete(
    parents: Float32[np.ndarray, "12 k"], x: np.float32, y: np.float32, own: Float32[np.ndarray, "k 4"],
    first: Row, second: Row, third: Row,
) -> None:  # fmt: skip
    """Write the means in a row along z: the sums there, and a little of the coarse expansions."""
    few = np.float32(_PARENT_SHARE)
    for k in range(len(first)):
        z = (np.float32(k) + np.float32(0.5)) * np.float32(1.0 / _SPLAT_SIZE)
        per_share = np.float32(1.0) / (own[k, 0] + few)
        a = parents[0, k] + parents[3, k] * x + parents[4, k] * y + parents[5, k] * z
        b = parents[1, k] + parents[6, k] * x + parents[7, k] * y + parents[8, k] * z
        c = parents[2, k] + parents[9, k] * x + parents[10, k] * y + parents[11, k] * z
        first[k] = (few * a + own[k, 1]) * per_share
        second[k] = (few * b + own[k, 2]) * per_share
        third[k] = (few * c + own[k, 3]) * per_share


@compiled
def _refine(values: Rows, beyond: np.float32, result: NewRows) -> None:
    """From the centres of few cells to those of more along the middle axis."""
    step = np.float32(values.shape[1]) / np.float32(result.shape[1])
    interpolate(values, np.float32(0.5) * step - np.float32(0.5), step, beyond, result)
