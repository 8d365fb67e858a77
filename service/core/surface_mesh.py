"""The surface of a grid as triangles, for people to look at and for files that other programs open."""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
from jaxtyping import Int32, Int64

from service.core.arrays import GRID_SIZE, Occupancy, Points, Probability, Transform
from service.core.grids import transform_points

Faces: TypeAlias = Int32[np.ndarray, "m 3"]
"""Indices of three vertices, counter-clockwise seen from outside."""

RELAXATIONS = 4
"""Steps that smooth the surface of a binary grid. The triangles of a ball of 20 voxels are 12° off its normals without
any, 6° after one, 2° after four; more gain nothing, and each makes the ball smaller by 0.02 voxels."""

CELLS = GRID_SIZE + 1
"""Cells along an edge: cubes between eight voxel centres, of the grid and of one empty voxel on each of its sides."""

_CORNERS = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=1)
_FROM, _TO = np.array([(a, b) for a in range(8) for b in range(a, 8) if (_CORNERS[a] != _CORNERS[b]).sum() == 1]).T


def surface_mesh(
    field: Probability | Occupancy, camera_from_grid: Transform, voxel_size_m: float, threshold: float = 0.5
) -> tuple[Points, Faces]:
    """The surface on which a field, interpolated between voxel centres, passes through the threshold.

    It is closed, also where the body touches a side of the grid: outside there is nothing. Each edge borders as many
    triangles to one side as to the other, two in all, or four where two sheets touch. A binary grid knows its surface
    to half a voxel only: there vertices are moved to the middle of their neighbours, within that half voxel, so that
    slopes are no stairs and walls one voxel thick stay.

    Args:
        field: Occupancy probability, or the voxels of a body.
        camera_from_grid: Pose of the grid.
        voxel_size_m: Edge of a voxel, positive.
        threshold: Between 0 and 1, above it is inside; of no account for a binary grid.

    Returns:
        Vertices in the camera frame, metres, and triangles. Both are empty where nothing is inside.

    Source: Gibson, Constrained Elastic Surface Nets, MICCAI 1998.
    """
    binary = field.dtype == np.bool_
    values = np.pad(field.astype(np.float32), 1)
    level = np.float32(0.5 if binary else threshold)
    inside = values > level
    cells = _crossed_cells(inside)
    corner = np.stack(np.unravel_index(cells, (CELLS,) * 3), axis=1)
    in_cell = _mean_crossing(values, corner, level)
    quads = _quads(inside, cells)
    if binary:
        in_cell = _relaxed(in_cell, corner, quads)
    # Voxel 0 of the grid is voxel 1 of the padded one, and its centre lies half a voxel inside the grid.
    vertices = ((corner + in_cell) - 0.5).astype(np.float32) * np.float32(voxel_size_m)
    vertices_m = transform_points(camera_from_grid, vertices)
    return vertices_m, _triangles(quads, vertices_m)


def vertex_normals(vertices: Points, faces: Faces) -> Points:
    """Unit normals of the vertices, outwards: the mean of those of their triangles, weighted by area."""
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    of_faces = np.cross(b - a, c - a)
    sums = np.stack(
        [np.bincount(faces.ravel(), np.repeat(of_faces[:, axis], 3), len(vertices)) for axis in range(3)], axis=1
    )
    lengths = np.linalg.norm(sums, axis=1, keepdims=True)
    # Where two sheets cancel each other there is no direction, and any will do.
    sums = np.where(lengths > 0.0, sums, [0.0, 0.0, 1.0])
    return (sums / np.where(lengths > 0.0, lengths, 1.0)).astype(np.float32)


def _crossed_cells(inside: np.ndarray) -> Int64[np.ndarray, " n"]:
    """Flat indices of the cells with corners on both sides."""
    corners = inside.astype(np.uint8)
    for _ in range(3):
        corners = np.moveaxis(corners[:-1] + corners[1:], 0, 2)
    return np.flatnonzero((corners > 0) & (corners < 8))


def _mean_crossing(values: np.ndarray, corner: np.ndarray, level: np.float32) -> np.ndarray:
    """The middle of the points where the edges of each cell are crossed, from its first corner, in voxels."""
    at_corners = values[tuple(np.moveaxis(corner[:, None] + _CORNERS, -1, 0))]
    before, after = at_corners[:, _FROM], at_corners[:, _TO]
    crossed = (before > level) != (after > level)
    share = np.where(crossed, level - before, 0.0) / np.where(crossed, after - before, 1.0)
    summed = crossed @ _CORNERS[_FROM] + share @ (_CORNERS[_TO] - _CORNERS[_FROM])
    return np.asarray(summed / crossed.sum(axis=1, keepdims=True))


def _quads(inside: np.ndarray, cells: Int64[np.ndarray, " n"]) -> Int64[np.ndarray, "q 4"]:
    """One for each pair of voxels on different sides, through the four cells that share the edge between them."""
    number = np.zeros(CELLS**3, np.int64)
    number[cells] = np.arange(len(cells))
    strides = (CELLS**2, CELLS, 1)
    quads = []
    for axis in range(3):
        low, high = (inside[(slice(None),) * axis + (slice(start, start + CELLS),)] for start in (0, 1))
        crossed = low != high
        first = np.stack(np.unravel_index(np.flatnonzero(crossed), crossed.shape))
        second, third = strides[(axis + 1) % 3], strides[(axis + 2) % 3]
        cell = np.tensordot(strides, first, 1)
        # Counter-clockwise seen from the high side, which is outside where the low one is in.
        around = cell[:, None] - np.array([second + third, third, 0, second])
        outwards = low[tuple(first)]
        quads.append(number[np.where(outwards[:, None], around, around[:, ::-1])])
    return np.concatenate(quads)


def _relaxed(in_cell: np.ndarray, corner: np.ndarray, quads: Int64[np.ndarray, "q 4"]) -> np.ndarray:
    """Each vertex in the middle of its neighbours, as far as its cell allows."""
    # The two quads at an edge run along it in opposite directions, so each direction is there once.
    here, there = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    neighbours = np.maximum(np.bincount(here, minlength=len(corner)), 1)
    for _ in range(RELAXATIONS):
        place = corner + in_cell
        middle = [np.bincount(here, place[there, axis], len(corner)) / neighbours for axis in range(3)]
        in_cell = np.clip(np.stack(middle, axis=1) - corner, 0.0, 1.0)
    return in_cell


def _triangles(quads: Int64[np.ndarray, "q 4"], vertices: Points) -> Faces:
    """Two of each quad, cut along its shorter diagonal."""
    one, other = (
        ((vertices[quads[:, start]] - vertices[quads[:, start + 2]]) ** 2).sum(axis=1) for start in (0, 1)
    )
    turned = np.where((one <= other)[:, None], quads, np.roll(quads, -1, axis=1))
    return turned[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3).astype(np.int32)
