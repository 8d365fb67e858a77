"""A body sampled once on a grid of distances, so that looking at it and asking what it fills cost little.

A shape is a tree of a dozen functions; asking it costs 0.1 to 0.3 µs a point, a ray asks twenty times and a picture
has tens of thousands of rays. Interpolating between nodes twice as dense as the voxels of a view grid costs a tenth of
that and rounds edges by a fraction of a node.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float32, Float64

from service.core.arrays import GRID_SIZE, Transform
from service.core.camera import Intrinsics
from service.core.compiled import compiled
from service.core.grids import Grid, invert_rigid
from training.simulation.distance_grid import DistanceGrid
from training.simulation.shapes import Bounds, Shape
from training.simulation.shapes.shape import SAFETY, TRUSTED_DEPTH, sample_points

CELLS = 96
"""Cells along the longest edge: thin walls are 2.5 cells and more, view grids have 47 voxels where this has 96."""
ROUGH = 24
"""Cells of a first look, which finds the box of the body."""
BLOCK = 4
"""Cells along a block whose nodes get one bound in common if the surface is far enough away."""
SMALLEST_STEP = 0.4
"""Cells that a ray advances at least: no wall that the grid shows is stepped over."""
SECANTS = 6


def sampled(shape: Shape, cells: int = CELLS) -> DistanceGrid:
    """The distances of a body on a grid around it, exact to the interpolation within a block of the surface.

    Farther away a value is the distance to the surface less what a block of nodes may be off by, which is what sphere
    tracing needs.

    Args:
        shape: The body, in any length unit.
        cells: Along its longest edge.

    Raises:
        ValueError: No sample of a first, rough look is inside the body.
    """
    box = _rough_box(shape)
    extent = box[:, 1] - box[:, 0]
    pitch = float(extent.max()) / cells
    # Whole blocks, with two cells to spare on each side.
    blocks = tuple(int(n) for n in np.ceil((extent / pitch + 5) / BLOCK))
    counts = np.array(blocks) * BLOCK
    low = box.mean(axis=1) - pitch * (counts - 1) / 2
    half = (BLOCK - 1) / 2 * pitch
    corner = np.stack([low - pitch / 2, low - pitch / 2 + counts * pitch], axis=1)
    centres = sample_points(corner, (blocks[0], blocks[1], blocks[2]))
    value = shape.distance(centres)
    reach = math.sqrt(3) * half
    far = np.sign(value) * np.maximum(np.abs(value) - np.float32(reach), np.float32(pitch))
    values = np.repeat(far[:, None], BLOCK**3, axis=1)
    near = np.abs(value) <= SAFETY * (reach + 2 * pitch)
    offsets = sample_points(np.array([[-half - pitch / 2, half + pitch / 2]] * 3), (BLOCK, BLOCK, BLOCK))
    values[near] = shape.distance((centres[near, None] + offsets).reshape(-1, 3)).reshape(-1, BLOCK**3)
    grid = values.reshape(*blocks, BLOCK, BLOCK, BLOCK).transpose(0, 3, 1, 4, 2, 5).reshape(tuple(counts))
    values = np.ascontiguousarray(grid, np.float32)
    return DistanceGrid(values, _triple(low), pitch, _pairs(_inner_box(values, low, pitch)))


def scaled(grid: DistanceGrid, factor: float) -> DistanceGrid:
    """The body scaled about the origin."""
    box = factor * grid.bounds
    return DistanceGrid(
        grid.values * np.float32(factor), _triple(factor * np.array(grid.low)), factor * grid.pitch, _pairs(box)
    )


def tipped(grid: DistanceGrid, quarter_turns: int) -> DistanceGrid:
    """The body turned about x by quarter turns, standing on z = 0 again and centred: 1 lays it down, 2 inverts it."""
    values = np.ascontiguousarray(np.rot90(grid.values, quarter_turns, axes=(1, 2)))
    # The box of the nodes turns like the values; only the body's place within it is needed.
    box = _inner_box(values, np.zeros(3), grid.pitch)
    low = -np.array([*box[:2].mean(axis=1), box[2, 0]])
    return replace(grid, values=values, low=_triple(low), body=_pairs(box + low[:, None]))


def filled(grid: DistanceGrid, view: Grid) -> Bool[np.ndarray, "x=64 y=64 z=64"]:
    """Voxels of a grid whose centres lie inside the body; the grid's "camera" frame is the body's own."""
    rotation = view.camera_from_grid[:3, :3] * (view.pitch_m / grid.pitch)
    first = (view.camera_from_grid[:3, 3] - np.array(grid.low)) / grid.pitch + rotation @ np.full(3, 0.5)
    result = np.zeros((GRID_SIZE,) * 3, bool)
    _fill(grid.values, rotation.astype(np.float64), first.astype(np.float64), result)
    return result


def trace_grid(
    grid: DistanceGrid,
    camera_from_world: Transform,
    intrinsics: Intrinsics,
    rows: slice,
    columns: slice,
    behind: Float32[np.ndarray, "h w"],
) -> Float32[np.ndarray, "h w"]:
    """Depth of the body over a window of the image, infinite where it is not met before `behind`; as `trace.trace`."""
    world_from_camera = invert_rigid(camera_from_world)
    eye = (world_from_camera[:3, 3] - np.array(grid.low)) / grid.pitch
    rotation = world_from_camera[:3, :3] / grid.pitch
    camera = np.array([intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy], np.float64)
    depth = np.full(behind.shape, np.inf, np.float32)
    _trace(
        grid.values, np.float64(grid.pitch), eye.astype(np.float64), rotation.astype(np.float64), camera, rows.start,
        columns.start, behind, depth,
    )  # fmt: skip
    return depth


def _rough_box(shape: Shape) -> Bounds:
    """A box that holds the body, no more than a rough cell larger than it on any side."""
    outer = shape.bounds
    extent = outer[:, 1] - outer[:, 0]
    counts = np.clip(np.ceil(extent / extent.max() * ROUGH), 4, None).astype(int)
    points = sample_points(outer, (int(counts[0]), int(counts[1]), int(counts[2])))
    half = extent / counts / 2
    # Any cell that the surface may cross or that lies inside.
    held = points[shape.distance(points) <= SAFETY * np.linalg.norm(half)]
    if not len(held):
        raise ValueError(f"no sample lies inside this {shape.family}: is it empty, or far thinner than its size?")
    low, high = np.maximum(held.min(axis=0) - half, outer[:, 0]), np.minimum(held.max(axis=0) + half, outer[:, 1])
    return np.stack([low, high], axis=1).astype(np.float64)


def _inner_box(
    values: Float32[np.ndarray, "x y z"], low: Float64[np.ndarray, "3"], pitch: float
) -> Float64[np.ndarray, "3 2"]:
    """Box of the balls about the inner nodes that lie inside the body: less than half a cell short of the body's own.

    Raises:
        ValueError: No node is inside.
    """
    inside = np.argwhere(values < 0)
    if not len(inside):
        raise ValueError("no node of the grid lies inside the body: its walls are thinner than the grid's cells")
    depth = TRUSTED_DEPTH * -values[values < 0][:, None] / pitch
    # Deep values are bounds of a whole block: they reach no farther than the surface.
    box = np.stack([(inside - depth).min(axis=0), (inside + depth).max(axis=0)], axis=1)
    return np.asarray(low[:, None] + pitch * box, np.float64)


def _triple(values: Float64[np.ndarray, "3"]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])


def _pairs(box: Bounds) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float]]:
    first, second, third = ((float(low), float(high)) for low, high in box)
    return first, second, third


@compiled
def _value(values: Float32[np.ndarray, "x y z"], x: float, y: float, z: float) -> float:
    """Trilinear value at a place within the grid, in cells."""
    i, j, k = int(x), int(y), int(z)
    i, j, k = min(i, values.shape[0] - 2), min(j, values.shape[1] - 2), min(k, values.shape[2] - 2)
    x, y, z = x - i, y - j, z - k
    a = values[i, j, k] + z * (values[i, j, k + 1] - values[i, j, k])
    b = values[i, j + 1, k] + z * (values[i, j + 1, k + 1] - values[i, j + 1, k])
    c = values[i + 1, j, k] + z * (values[i + 1, j, k + 1] - values[i + 1, j, k])
    d = values[i + 1, j + 1, k] + z * (values[i + 1, j + 1, k + 1] - values[i + 1, j + 1, k])
    a, c = a + y * (b - a), c + y * (d - c)
    return float(a + x * (c - a))


@compiled
def _fill(
    values: Float32[np.ndarray, "x y z"],
    rotation: Float64[np.ndarray, "3 3"],
    first: Float64[np.ndarray, "3"],
    result: Bool[np.ndarray, "n n n"],
) -> None:
    size = result.shape[0]
    for i in range(size):
        for j in range(size):
            for k in range(size):
                x = first[0] + rotation[0, 0] * i + rotation[0, 1] * j + rotation[0, 2] * k
                y = first[1] + rotation[1, 0] * i + rotation[1, 1] * j + rotation[1, 2] * k
                z = first[2] + rotation[2, 0] * i + rotation[2, 1] * j + rotation[2, 2] * k
                if x < 0 or y < 0 or z < 0:
                    continue
                if x > values.shape[0] - 1 or y > values.shape[1] - 1 or z > values.shape[2] - 1:
                    continue
                result[i, j, k] = _value(values, x, y, z) < 0


@compiled
def _trace(
    values: Float32[np.ndarray, "x y z"],
    pitch: float,
    eye: Float64[np.ndarray, "3"],
    rotation: Float64[np.ndarray, "3 3"],
    camera: Float64[np.ndarray, "4"],
    first_row: int,
    first_column: int,
    behind: Float32[np.ndarray, "h w"],
    depth: Float32[np.ndarray, "h w"],
) -> None:
    """Sphere tracing (Hart, 1996), every pixel by itself, places and directions in cells of the grid."""
    for row in range(depth.shape[0]):
        b = (first_row + row - camera[3]) / camera[1]
        for column in range(depth.shape[1]):
            a = (first_column + column - camera[2]) / camera[0]
            dx = rotation[0, 0] * a + rotation[0, 1] * b + rotation[0, 2]
            dy = rotation[1, 0] * a + rotation[1, 1] * b + rotation[1, 2]
            dz = rotation[2, 0] * a + rotation[2, 1] * b + rotation[2, 2]
            near, far = 0.0, float(behind[row, column])
            for axis in range(3):
                d = dx if axis == 0 else dy if axis == 1 else dz
                d = d if abs(d) > 1e-9 else 1e-9
                first = -eye[axis] / d
                second = (values.shape[axis] - 1 - eye[axis]) / d
                near, far = max(near, min(first, second)), min(far, max(first, second))
            if near >= far:
                continue
            # Metres along the ray for each metre of depth; a value in metres over it is a step of depth.
            length = np.sqrt(dx * dx + dy * dy + dz * dz) * pitch
            smallest = SMALLEST_STEP * pitch / length
            t, before, above = near, near, 1.0
            while t < far:
                value = _value(
                    values, max(eye[0] + t * dx, 0.0), max(eye[1] + t * dy, 0.0), max(eye[2] + t * dz, 0.0)
                )
                if value < 0:
                    # Between a place outside and one inside: regula falsi with the Illinois rule.
                    inner, below = t, value
                    for _ in range(SECANTS):
                        t = before + (inner - before) * above / (above - below)
                        value = _value(
                            values, max(eye[0] + t * dx, 0.0), max(eye[1] + t * dy, 0.0), max(eye[2] + t * dz, 0.0)
                        )
                        if value > 0:
                            before, above, below = t, value, 0.5 * below
                        else:
                            inner, below, above = t, value, 0.5 * above
                    if t < far:
                        depth[row, column] = t
                    break
                before, above = t, value
                t += max(value / length, smallest)
