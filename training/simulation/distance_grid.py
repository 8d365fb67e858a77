"""A closed surface of triangles as a grid of signed distances."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int32, Int64
from scipy import ndimage
from scipy.spatial import cKDTree

from training.simulation.shapes import Bounds, Field
from training.simulation.shapes.field import Coordinate, Distance

RESOLUTION = 96
"""Cells along the longest edge of the distance grid."""
EXACT_CELLS = 2
"""Nodes this near to the surface get their exact distance unless more is asked for; the zero set needs no more."""
HALF_DIAGONAL = math.sqrt(3) / 2

Triangles: TypeAlias = Float64[np.ndarray, "m corner=3 xyz=3"]


@dataclass(frozen=True, eq=False)
class DistanceGrid(Field):
    """Signed distances on a regular grid, interpolated trilinearly.

    Beyond the grid the value is a lower bound: the distance to the grid's box, or to the surface less that, whichever
    is larger.

    Attributes:
        values: At the nodes, indexed [x, y, z].
        low: Position of node (0, 0, 0).
        pitch: Distance between nodes.
        body: Box of the body within the grid.
    """

    values: Float32[np.ndarray, "x y z"] = field(repr=False)
    low: tuple[float, float, float]
    pitch: float
    body: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        beyond = np.zeros(x.shape, np.float32)
        cells, fractions = [], []
        for coordinate, low, count in zip((x, y, z), self.low, self.values.shape, strict=True):
            place = (coordinate - np.float32(low)) * np.float32(1 / self.pitch)
            inside = np.clip(place, np.float32(0), np.float32(count - 1))
            beyond += (place - inside) ** 2
            # The corner stays a float until the fraction is taken: float32 less int32 would be float64.
            corner = np.minimum(np.floor(inside), np.float32(count - 2))
            cells.append(corner.astype(np.int32))
            fractions.append(inside - corner)
        _, ny, nz = self.values.shape
        first_node = (cells[0] * ny + cells[1]) * nz + cells[2]
        flat, (fx, fy, fz) = self.values.ravel(), fractions
        edges = []
        for offset in (0, nz, ny * nz, ny * nz + nz):
            first = flat[first_node + offset]
            edges.append(first + fz * (flat[first_node + (offset + 1)] - first))
        near, far = (edges[i] + fy * (edges[i + 1] - edges[i]) for i in (0, 2))
        value = near + fx * (far - near)
        outside = np.sqrt(beyond) * np.float32(self.pitch)
        distance: Distance = np.where(outside > 0, np.maximum(outside, value - outside), value)
        return distance

    @property
    def bounds(self) -> Bounds:
        return np.array(self.body, np.float64)


def distance_grid(
    triangles: Triangles, resolution: int = RESOLUTION, exact_cells: int = EXACT_CELLS
) -> DistanceGrid:
    """Signed distances of a closed, outward-facing surface.

    Within a few cells of the surface the distance is the exact one to the triangles of the two nearest surface samples;
    farther away it is a lower bound, short by at most two cells.

    Args:
        triangles: Corners of the faces.
        resolution: Cells along the longest edge.
        exact_cells: How many cells from the surface the distance is exact: two for its place, more for its slope.
    """
    margin = exact_cells + 1
    corners = triangles.reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    pitch = float((high - low).max() / resolution)
    counts = np.ceil((high - low) / pitch).astype(int) + 1 + 2 * margin
    origin = low - margin * pitch
    axes = [origin[axis] + pitch * np.arange(counts[axis]) for axis in range(3)]
    samples, owner = _sample_surface(triangles, 0.4 * pitch)
    # Far away the distance to the nearest node that the surface passes by is enough. The surface lies within half a
    # cell's diagonal of that node; less that, the value is a lower bound.
    passed = np.zeros(counts, bool)
    passed[tuple(np.rint((samples - origin) / pitch).astype(int).T)] = True
    distance = (ndimage.distance_transform_edt(~passed) - HALF_DIAGONAL) * pitch
    band = np.argwhere(distance < exact_cells * pitch)
    nodes = origin + pitch * band
    nearest = np.asarray(cKDTree(samples).query(nodes, k=2)[1], np.int64)
    distance[tuple(band.T)] = np.minimum(
        _triangle_distance(nodes, triangles[owner[nearest[:, 0]]]),
        _triangle_distance(nodes, triangles[owner[nearest[:, 1]]]),
    )
    inside = _inside(triangles, axes)
    signed = np.where(inside, -distance, distance).astype(np.float32)
    box = [(float(low[axis]), float(high[axis])) for axis in range(3)]
    return DistanceGrid(signed, (float(origin[0]), float(origin[1]), float(origin[2])), pitch, (box[0], box[1], box[2]))


def _sample_surface(triangles: Triangles, spacing: float) -> tuple[Float64[np.ndarray, "n 3"], Int64[np.ndarray, " n"]]:
    """Points no more than `spacing` apart on every triangle, and the triangle of each.

    Rows run along the shortest edge, so that slivers get as few points as their area asks for.
    """
    lengths = np.linalg.norm(np.roll(triangles, -1, axis=1) - triangles, axis=2)
    shortest = lengths.argmin(axis=1)
    every = np.arange(len(triangles))
    a, b, c = (triangles[every, (shortest + turn) % 3] for turn in range(3))
    across = np.maximum(np.ceil(lengths[every, shortest] / spacing), 1).astype(np.int64)
    along = np.maximum(np.ceil(lengths.max(axis=1) / spacing), 1).astype(np.int64)
    points, owners = [], []
    for count_u, count_v in np.unique(np.stack([across, along], axis=1), axis=0):
        chosen = np.flatnonzero((across == count_u) & (along == count_v))
        v, u = np.meshgrid(np.linspace(0, 1, count_v + 1), np.linspace(0, 1, count_u + 1), indexing="ij")
        u, v = (u * (1 - v)).reshape(-1, 1), v.reshape(-1, 1)
        part = a[chosen, None] + u * (b - a)[chosen, None] + v * (c - a)[chosen, None]  # (triangles, samples, xyz)
        points.append(part.reshape(-1, 3))
        owners.append(np.repeat(chosen, len(u)))
    return np.concatenate(points), np.concatenate(owners)


def _triangle_distance(
    points: Float64[np.ndarray, "n 3"], triangles: Float64[np.ndarray, "n corner=3 xyz=3"]
) -> Float64[np.ndarray, " n"]:
    """Distance from each point to its triangle: to the face where the perpendicular meets it, else to an edge."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    squared = np.full(len(points), np.inf)
    over = np.ones(len(points), bool)
    for start, end in ((a, b), (b, c), (c, a)):
        edge, offset = end - start, points - start
        along = np.clip(_dot(offset, edge) / np.maximum(_dot(edge, edge), 1e-30), 0, 1)
        gap = offset - along[:, None] * edge
        squared = np.minimum(squared, _dot(gap, gap))
        over &= _dot(np.cross(edge, offset), normal) >= 0
    height = np.abs(_dot(points - a, normal)) / np.maximum(np.sqrt(_dot(normal, normal)), 1e-30)
    return np.asarray(np.where(over, height, np.sqrt(squared)), np.float64)


def _dot(a: Float64[np.ndarray, "n 3"], b: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, " n"]:
    return np.asarray(np.einsum("ij,ij->i", a, b), np.float64)


def _inside(triangles: Triangles, axes: list[Float64[np.ndarray, " _"]]) -> Bool[np.ndarray, "x y z"]:
    """Nodes whose winding number is not zero, so that overlapping parts of one file count as their union.

    Each face adds its orientation to the nodes below it, for the columns of nodes that pass through it. The columns
    are moved aside by an irrational hair so that none runs through an edge or a corner.
    """
    counts = [len(axis) for axis in axes]
    pitch = axes[0][1] - axes[0][0]
    origin = np.array([axes[0][0] + pitch * 7.123e-5, axes[1][0] + pitch * 3.317e-5])
    local = triangles.copy()
    local[:, :, :2] = (local[:, :, :2] - origin) / pitch
    local[:, :, 2] = (local[:, :, 2] - axes[2][0]) / pitch
    first = np.ceil(local[:, :, :2].min(axis=1)).astype(int)
    spans = np.floor(local[:, :, :2].max(axis=1)).astype(int) - first + 1
    crossing = (spans > 0).all(axis=1)
    # Faces in classes of like size, so that each class is one array operation.
    size = np.where(crossing, 2 ** np.ceil(np.log2(np.maximum(spans.max(axis=1), 1))), 0).astype(int)
    change = np.zeros((counts[0], counts[1], counts[2] + 1), np.int32)
    for width in np.unique(size[crossing]):
        chosen = np.flatnonzero(size == width)
        for part in np.array_split(chosen, max(1, len(chosen) * width * width // 500_000)):
            _count_crossings(change, local[part], first[part], int(width))
    return np.asarray(np.cumsum(change, axis=2)[:, :, :-1] != 0)


def _count_crossings(
    change: Int32[np.ndarray, "x y z"], triangles: Triangles, first: Int64[np.ndarray, "m 2"], width: int
) -> None:
    """Add the orientation of faces, in cells, to the nodes below them; columns start at `first`."""
    i, j = np.meshgrid(np.arange(width), np.arange(width), indexing="ij")
    columns_i, columns_j = first[:, 0, None, None] + i, first[:, 1, None, None] + j
    a, b, c = (triangles[:, corner, :, None, None] for corner in range(3))
    bx, by, cx, cy = b[:, 0] - a[:, 0], b[:, 1] - a[:, 1], c[:, 0] - a[:, 0], c[:, 1] - a[:, 1]
    area = bx * cy - cx * by
    px, py = columns_i - a[:, 0], columns_j - a[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):  # faces seen edge-on hit no column
        wb, wc = (px * cy - cx * py) / area, (bx * py - px * by) / area
        hit = np.nonzero((wb >= 0) & (wc >= 0) & (wb + wc <= 1) & (area != 0))
        height = a[:, 2] + wb * (b[:, 2] - a[:, 2]) + wc * (c[:, 2] - a[:, 2])
    level = np.clip(np.ceil(height[hit]), 0, change.shape[2] - 1).astype(int)
    sign = np.where(area[:, 0, 0] > 0, 1, -1).astype(np.int32)[hit[0]]
    rows, columns = columns_i[hit], columns_j[hit]
    # An upward face ends the body: nodes below it are inside by one more.
    np.add.at(change, (rows, columns, np.zeros_like(level)), sign)
    np.add.at(change, (rows, columns, level), -sign)
