"""From the nodal displacements of a coarse solve to fields on the 32³ lattice that the network works on."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from service.core.prior_grid import POINTS_27, CellGrid, shape_functions
from service.core.prior_rotation import cofactor

FIELD_SIZE = 32
"""Nodes of the lattice along each edge; node i lies at (i + ½)/32."""

_SPLAT_SIZE = 16
_PARENT_SHARE = 0.01
"""What the coarser level counts for where the finer one has samples of its own; elsewhere it counts for all."""
_VOID_SHARE = 0.02
"""What a sample counts for that stands for no material: it continues the field around the body."""
_MIN_DETERMINANT = 0.1

_SHAPE_27: Float32[np.ndarray, "27 8"] = shape_functions(POINTS_27).astype(np.float32)
_FULL_27 = np.outer(np.outer([5.0, 8.0, 5.0], [5.0, 8.0, 5.0]), [5.0, 8.0, 5.0]).ravel() / 18.0**3

Field = Float32[np.ndarray, "axis=3 x=32 y=32 z=32"]


def backward_field(
    grid: CellGrid, displacement: Float32[np.ndarray, "3 n"], gradient: Float32[np.ndarray, "3 3 m"]
) -> Field:
    """u_b(y), with y − u_b(y) the material point at rest that lies at y after the load.

    27 points of every cell are carried forward, each with the first-order expansion of the backward field around it,
    ∇u_b = I − F⁻¹; a lattice of 16³ averages the expansions that fall into each of its cells, empty cells take those of
    the coarser lattices, and the values at its centres are interpolated. No iteration is needed, whatever the rotation.
    Outside the deformed body the field continues smoothly.

    Args:
        grid: Cells of the body.
        displacement: Displacement of every node.
        gradient: F at the centre of every cell.
    """
    # points of a cell first, cells last: long inner loops
    moved = np.matmul(_SHAPE_27, displacement[:, grid.cell_nodes.T])  # (3, 27, m)
    offset = grid.low[:, None] + grid.cells.T * grid.edges[:, None]
    rest = (offset[:, None] + (POINTS_27 * grid.edges).T[:, :, None]).astype(np.float32)
    place = rest + moved
    slope = _slope(gradient)  # (3, 3, m)
    share = np.maximum(grid.weights / _FULL_27[:, None], 0.0).astype(np.float32) + np.float32(_VOID_SHARE)
    index = np.clip(place * np.float32(_SPLAT_SIZE), 0, _SPLAT_SIZE - 1).astype(np.int32)
    flat = ((index[0] * _SPLAT_SIZE + index[1]) * _SPLAT_SIZE + index[2]).ravel()
    channels = np.empty((13, *share.shape), np.float32)
    channels[0] = 1.0
    channels[1:4] = moved - (slope[:, :, None] * place).sum(axis=1)
    channels[4:] = slope.reshape(9, 1, -1)
    channels *= share
    size = _SPLAT_SIZE**3
    total = np.stack([np.bincount(flat, weights=channel.ravel(), minlength=size) for channel in channels])
    filled = _filled(total.astype(np.float32).reshape((13,) + (_SPLAT_SIZE,) * 3))
    centre = ((np.arange(_SPLAT_SIZE) + 0.5) / _SPLAT_SIZE).astype(np.float32)
    values = filled[1:4].copy()
    values += filled[4::3] * centre[:, None, None]
    values += filled[5::3] * centre[:, None]
    values += filled[6::3] * centre
    values /= filled[0]
    return _each_axis(_TO_FIELD, values)


def _slope(gradient: Float32[np.ndarray, "3 3 m"]) -> Float32[np.ndarray, "3 3 m"]:
    """I − F⁻¹ of every cell; the rate of change is left out where a cell is turned inside out."""
    cofactors, determinant = cofactor(gradient.reshape(9, -1))
    good = determinant > _MIN_DETERMINANT
    inverse = cofactors.reshape(3, 3, -1).transpose(1, 0, 2) / np.where(good, determinant, 1.0)
    slope = np.eye(3, dtype=np.float32)[:, :, None] - inverse
    return np.asarray(np.where(good, slope, 0.0), np.float32)


def _filled(channels: Float32[np.ndarray, "c x y z"]) -> Float32[np.ndarray, "c x y z"]:
    """Sums of samples, completed where there are few from those of lattices a quarter as fine."""
    size = channels.shape[1]
    if size <= 4:
        return np.asarray(channels + np.float32(_PARENT_SHARE) * channels.mean(axis=(1, 2, 3), keepdims=True))
    parent = _filled(_each_axis(_POOLING, channels))
    parent *= np.float32(_PARENT_SHARE) / parent[:1]
    return np.asarray(channels + _each_axis(_SPREADING, parent))


def _each_axis(
    table: Float32[np.ndarray, "new old"], values: Float32[np.ndarray, "c _ _ _"]
) -> Float32[np.ndarray, "c _ _ _"]:
    """A table applied along x, y and z; matrix products are many times faster than sums over strides."""
    c, new, old = len(values), *table.shape
    along_z = values @ table.T
    along_y = np.matmul(table, along_z)
    return np.asarray(np.matmul(table, along_y.reshape(c, old, new * new)).reshape(c, new, new, new))


def _interpolation(coarse: int, fine: int, continued: bool) -> Float32[np.ndarray, "fine coarse"]:
    """Linear interpolation from the centres of `coarse` cells to those of `fine`; past the last continued or held."""
    place = (np.arange(fine) + 0.5) * coarse / fine - 0.5
    if not continued:
        place = np.clip(place, 0.0, coarse - 1.0)
    below = np.clip(np.floor(place).astype(int), 0, coarse - 2)
    table = np.zeros((fine, coarse), np.float32)
    table[np.arange(fine), below] = 1.0 - (place - below)
    table[np.arange(fine), below + 1] = place - below
    return table


_TO_FIELD = _interpolation(_SPLAT_SIZE, FIELD_SIZE, continued=True)
_SPREADING = _interpolation(_SPLAT_SIZE // 4, _SPLAT_SIZE, continued=False)
_POOLING = np.repeat(np.eye(_SPLAT_SIZE // 4, dtype=np.float32), 4, axis=1)
