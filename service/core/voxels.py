"""From segmented points to a 64³ grid whose voxels are observed, free or unknown."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Float32, Float64

from service.core.arrays import (
    GRID_SIZE,
    DepthImage,
    Matrix3,
    Occupancy,
    Points,
    Probability,
    Transform,
    Vector3,
)
from service.core.camera import Intrinsics, project
from service.core.compiled import compiled
from service.core.extent import filled_range
from service.core.grids import Grid, centres_seen_from, crossed

EDGE_OVER_EXTENT = 1.35
"""Edge of the view grid over the largest observed extent."""

FRONT_MARGIN = 0.10
"""Share of the edge left free before the nearest observed point. What remains behind it, 0.9 · 1.35 = 1.2 times the
largest observed extent, is the room for the side that the camera does not see."""

OUTLIER_PERCENTILE = 0.5
"""Points beyond this percentile on either side do not stretch the grid: stereo sensors leave stray readings."""

FREE_MARGIN_VOXELS = 1.0
"""A voxel is free only if the ray passes its centre by this much before it hits: the centre of a voxel that holds a
surface point lies at most √3/2 voxels before it."""

States: TypeAlias = Float32[np.ndarray, "state=2 x=64 y=64 z=64"]

_BLOCK = 256
"""Points that are taken at a time."""

_FEW = 64
"""Values that are looked at as one: few blocks of so many hold one that is among the lowest."""

HORIZONTAL_VIEW = 0.05
"""Below this sine between the optical axis and `up` the view has no usable heading (the camera looks straight down)."""


@dataclass(frozen=True)
class VoxelView:
    """What one frame says about each voxel of its view grid.

    Attributes:
        grid: The view grid: z along `up` with its floor on the support plane, x horizontally away from the camera.
        observed: Voxels that hold a point of the object's surface.
        free: Voxels that a ray crossed on its way to a farther reading. Neither observed nor free: unknown.
    """

    grid: Grid
    observed: Occupancy
    free: Occupancy

    @property
    def layers(self) -> int:
        """Layers of voxels, from the floor up, that the object can fill.

        A camera that stands higher than all it sees of the object sees its highest point too: what could hide it would
        be higher still.
        """
        seen = filled_range(self.observed)
        if seen is None:
            return GRID_SIZE
        above = seen[1][2]
        camera_height = float(self.grid.grid_from_camera[2, 3]) / self.grid.pitch_m
        return above if camera_height > above else GRID_SIZE


def states_of(view: VoxelView) -> States:
    """The view as the network reads it: 1 where a voxel is observed, and where it is free."""
    states = np.empty((2, *view.free.shape), np.float32)
    _tell_states(view.observed, view.free, states)
    return states


@compiled
def _tell_states(observed: Occupancy, free: Occupancy, states: States) -> None:
    for i in range(GRID_SIZE):
        for j in range(GRID_SIZE):
            for k in range(GRID_SIZE):
                states[0, i, j, k] = np.float32(observed[i, j, k])
                states[1, i, j, k] = np.float32(free[i, j, k])


def rule_out(probability: Probability, view: VoxelView) -> None:
    """Put zero where the view says that there is no object: in free voxels, and above its `layers`."""
    _rule_out(probability, view.free, view.layers)


@compiled
def _rule_out(probability: Probability, free: Occupancy, layers: int) -> None:
    for i in range(GRID_SIZE):
        for j in range(GRID_SIZE):
            for k in range(GRID_SIZE):
                empty = free[i, j, k] or k >= layers
                probability[i, j, k] = np.float32(0.0) if empty else probability[i, j, k]


def view_axes(up: Vector3) -> Transform:
    """Rotation camera_from_view: z against gravity, x along the viewing direction made horizontal, right-handed."""
    z0, z1, z2 = up.tolist()
    length = math.sqrt(z0 * z0 + z1 * z1 + z2 * z2)
    z0, z1, z2 = z0 / length, z1 / length, z2 / length
    x0, x1, x2 = -z2 * z0, -z2 * z1, 1.0 - z2 * z2  # the optical axis without its part along z
    if x0 * x0 + x1 * x1 + x2 * x2 < HORIZONTAL_VIEW**2:
        # Straight down: the top of the image (-y) takes the place of "away from the camera".
        x0, x1, x2 = z1 * z0, z1 * z1 - 1.0, z1 * z2
    length = math.sqrt(x0 * x0 + x1 * x1 + x2 * x2)
    x0, x1, x2 = x0 / length, x1 / length, x2 / length
    y0, y1, y2 = crossed((z0, z1, z2), (x0, x1, x2))
    return np.array([[x0, y0, z0, 0.0], [x1, y1, z1, 0.0], [x2, y2, z2, 0.0], [0.0, 0.0, 0.0, 1.0]])


def view_grid(points: Points, up: Vector3, support_offset_m: float) -> Grid:
    """Place the view grid on the support plane around the observed points (camera frame).

    Args:
        points: Points of the object's visible surface, camera frame, metres; at least one.
        up: Direction against gravity in the camera frame.
        support_offset_m: The support plane is where `up · p + support_offset_m = 0`.
    """
    camera_from_view = view_axes(up)
    low_x, low_y, high_x, high_y, high_z = _bounds(points, camera_from_view[:3, :3].astype(np.float32))
    edge_m = EDGE_OVER_EXTENT * max(high_x - low_x, high_y - low_y, high_z + support_offset_m, 1e-3)
    corner = np.array([low_x - FRONT_MARGIN * edge_m, (low_y + high_y - edge_m) / 2, -support_offset_m])
    camera_from_view[:3, 3] = camera_from_view[:3, :3] @ corner
    return Grid(pitch_m=edge_m / GRID_SIZE, camera_from_grid=camera_from_view)


@compiled
def _bounds(points: Points, axes: Float32[np.ndarray, "3 axis=3"]) -> tuple[float, float, float, float, float]:
    """Lowest x and y and highest x, y and z of points along the columns of a rotation, but for outliers."""
    x, y, z = np.empty((3, len(points)), np.float32)
    for point in range(len(points)):
        a, b, c = points[point, 0], points[point, 1], points[point, 2]
        x[point] = axes[0, 0] * a + axes[1, 0] * b + axes[2, 0] * c
        y[point] = axes[0, 1] * a + axes[1, 1] * b + axes[2, 1] * c
        z[point] = -(axes[0, 2] * a + axes[1, 2] * b + axes[2, 2] * c)
    low_x, low_y, high_z = _without_outliers(x), _without_outliers(y), -_without_outliers(z)
    for point in range(len(points)):
        x[point], y[point] = -x[point], -y[point]
    return low_x, low_y, -_without_outliers(x), -_without_outliers(y), high_z


@compiled
def _without_outliers(values: Float32[np.ndarray, " n"]) -> float:
    """The value at `OUTLIER_PERCENTILE`, as `np.percentile` finds it, though only the lowest values are sorted."""
    place = OUTLIER_PERCENTILE / 100.0 * (len(values) - 1)
    below = int(place)
    share = place - below
    # A sixteenth of the values tells about how low the wanted one is: this far in, about twice as many are lower.
    few = np.full(min(below // 8 + 5, (len(values) + 15) // 16), np.float32(np.inf))
    for i in range(0, len(values), 16):
        _insert(few, values[i])
    limit, count = few[-1], 0
    lowest = np.empty(len(values), np.float32)
    for first in range(0, len(values), _FEW):
        block, lower = values[first : first + _FEW], 0
        for value in block:
            lower += value <= limit
        if lower:
            for value in block:
                lowest[count] = value
                count += value <= limit
    ascending = np.sort(lowest[:count] if count > below + 1 else values)
    above = min(below + 1, len(ascending) - 1)
    return (1.0 - share) * np.float64(ascending[below]) + share * np.float64(ascending[above])


@compiled
def _insert(lowest: Float32[np.ndarray, " n"], value: np.float32) -> None:
    """Put a value among the lowest ones, in ascending order, in place of the highest of them, if it is lower."""
    place = len(lowest) - 1
    if value < lowest[place]:
        while place > 0 and lowest[place - 1] > value:
            lowest[place] = lowest[place - 1]
            place -= 1
        lowest[place] = value


def voxelize_points(points: Points, grid: Grid) -> Occupancy:
    """Mark the voxels that hold at least one of the points (camera frame, metres); points outside are left out."""
    grid_from_camera = grid.grid_from_camera.astype(np.float32)
    occupied = np.zeros((GRID_SIZE,) * 3, np.bool_)
    _mark(points, grid_from_camera, np.float32(grid.pitch_m), occupied)
    return occupied


@compiled
def _mark(points: Points, t: Float32[np.ndarray, "4 4"], pitch_m: np.float32, occupied: Occupancy) -> None:
    """Mark the voxels that hold a point; t is the transform grid_from_camera.

    A block of points at a time is laid out axis by axis, so that eight are found at once.
    """
    size, nothing, per_m = np.float32(GRID_SIZE), np.float32(0.0), np.float32(1.0) / pitch_m
    across, voxel, voxels = np.empty((3, _BLOCK), np.float32), np.empty(_BLOCK, np.int32), occupied.ravel()
    for first in range(0, len(points), _BLOCK):
        count = _BLOCK if first + _BLOCK <= len(points) else len(points) - first
        for point in range(count):
            for axis in range(3):
                across[axis, point] = points[first + point, axis]
        for point in range(count):
            x, y, z = across[0, point], across[1, point], across[2, point]
            i = (t[0, 0] * x + t[0, 1] * y + t[0, 2] * z + t[0, 3]) * per_m
            j = (t[1, 0] * x + t[1, 1] * y + t[1, 2] * z + t[1, 3]) * per_m
            k = (t[2, 0] * x + t[2, 1] * y + t[2, 2] * z + t[2, 3]) * per_m
            inside = (i >= nothing) & (i < size) & (j >= nothing) & (j < size) & (k >= nothing) & (k < size)
            i, j, k = (i if inside else nothing), (j if inside else nothing), (k if inside else nothing)
            place = (np.int32(i) * np.int32(GRID_SIZE) + np.int32(j)) * np.int32(GRID_SIZE) + np.int32(k)
            voxel[point] = np.int32(place) if inside else np.int32(-1)
        for point in range(count):
            if voxel[point] >= 0:
                voxels[np.uint32(voxel[point])] = True


def carve_free(depth_m: DepthImage, intrinsics: Intrinsics, grid: Grid) -> Occupancy:
    """Mark the voxels that some ray crossed before it hit: the reading at the centre's pixel lies behind the voxel."""
    free = np.empty((GRID_SIZE,) * 3, np.bool_)
    margin_m = np.float32(FREE_MARGIN_VOXELS * grid.pitch_m)
    if intrinsics.distortion is not None:
        centres = centres_seen_from(grid.camera_from_grid[:3, :3], grid.pitch_m, grid.camera_from_grid[:3, 3])
        points = np.stack([axis.ravel() for axis in centres], axis=1)
        pixels, _ = project(points, intrinsics)
        reading = _readings_at(depth_m, pixels)
        # NaN compares false: where the sensor gave nothing, nothing is known.
        return np.asarray((reading > points[:, 2] + margin_m).reshape(free.shape), np.bool_)
    # u z, v z and z of a voxel's centre are linear in its three indices.
    along = intrinsics.matrix @ grid.camera_from_grid[:3, :3] * grid.pitch_m
    first = intrinsics.matrix @ grid.camera_from_grid[:3, 3] + along.sum(axis=1) / 2
    _carve(depth_m, first, along, margin_m, free)
    return free


@compiled
def _carve(depth_m: DepthImage, first: Vector3, along: Matrix3, margin_m: np.float32, free: Occupancy) -> None:
    """Carve a column of voxels at a time: first where each is seen, eight at once, then what is read there."""
    readings = depth_m.ravel()
    width, height = np.float32(depth_m.shape[1]), np.float32(depth_m.shape[0])
    columns = np.int32(depth_m.shape[1])
    pixel, behind_m = np.empty(GRID_SIZE, np.int32), np.empty(GRID_SIZE, np.float32)
    half, nothing, never = np.float32(0.5), np.float32(0.0), np.float32(np.inf)
    step_u, step_v, step_z = np.float32(along[0, 2]), np.float32(along[1, 2]), np.float32(along[2, 2])
    for i in range(GRID_SIZE):
        for j in range(GRID_SIZE):
            start_u = np.float32(first[0] + along[0, 0] * i + along[0, 1] * j)
            start_v = np.float32(first[1] + along[1, 0] * i + along[1, 1] * j)
            start_z = np.float32(first[2] + along[2, 0] * i + along[2, 1] * j)
            for k in range(GRID_SIZE):
                step = np.float32(k)
                z = start_z + step * step_z
                inverse = np.float32(1.0) / z
                # Pixel centres have whole coordinates; from half a pixel before, whole numbers are pixels.
                u = (start_u + step * step_u) * inverse + half
                v = (start_v + step * step_v) * inverse + half
                # What is behind the camera would appear in the image, too, upside down.
                inside = (z > nothing) & (u >= nothing) & (u < width) & (v >= nothing) & (v < height)
                pixel[k] = np.int32(v if inside else nothing) * columns + np.int32(u if inside else nothing)
                behind_m[k] = z + margin_m if inside else never
            for k in range(GRID_SIZE):
                # NaN compares false: where the sensor gave nothing, nothing is known.
                free[i, j, k] = readings[np.uint32(pixel[k])] > behind_m[k]


def _readings_at(depth_m: DepthImage, pixels: Float64[np.ndarray, "n 2"]) -> Float32[np.ndarray, " n"]:
    """The reading at the pixel that each place (u, v) lies in; NaN outside the image."""
    column, row = np.rint(np.nan_to_num(pixels, nan=-1.0, posinf=-1.0, neginf=-1.0).T)
    inside = (column >= 0) & (column < depth_m.shape[1]) & (row >= 0) & (row < depth_m.shape[0])
    column, row = (np.where(inside, place, 0.0).astype(np.intp) for place in (column, row))
    return np.where(inside, depth_m[row, column], np.float32(np.nan))


def voxelize(
    points: Points, depth_m: DepthImage, intrinsics: Intrinsics, up: Vector3, support_offset_m: float
) -> VoxelView:
    """Points of the object and the whole depth image to a view grid with its three kinds of voxels."""
    grid = view_grid(points, up, support_offset_m)
    observed = voxelize_points(points, grid)
    free = carve_free(depth_m, intrinsics, grid)
    np.greater(free, observed, out=free)  # free and not observed
    return VoxelView(grid=grid, observed=observed, free=free)
