"""From segmented points to a 64³ grid whose voxels are observed, free or unknown."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool

from service.core.arrays import GRID_SIZE, DepthImage, Occupancy, Points, Transform, Vector3
from service.core.camera import Intrinsics, project
from service.core.grids import Grid, centres_seen_from, transform_points

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


def view_axes(up: Vector3) -> Transform:
    """Rotation camera_from_view: z against gravity, x along the viewing direction made horizontal, right-handed."""
    z = up / np.linalg.norm(up)
    optical_axis = np.array([0.0, 0.0, 1.0])
    x = optical_axis - (optical_axis @ z) * z
    if np.linalg.norm(x) < HORIZONTAL_VIEW:
        # Straight down: the top of the image (-y) takes the place of "away from the camera".
        image_top = np.array([0.0, -1.0, 0.0])
        x = image_top - (image_top @ z) * z
    x /= np.linalg.norm(x)
    camera_from_view = np.eye(4)
    camera_from_view[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    return camera_from_view


def view_grid(points: Points, up: Vector3, support_offset_m: float) -> Grid:
    """Place the view grid on the support plane around the observed points (camera frame).

    Args:
        points: Points of the object's visible surface, camera frame, metres; at least one.
        up: Direction against gravity in the camera frame.
        support_offset_m: The support plane is where `up · p + support_offset_m = 0`.
    """
    camera_from_view = view_axes(up)
    local = points @ camera_from_view[:3, :3].astype(np.float32)
    low, high = np.percentile(local, [OUTLIER_PERCENTILE, 100.0 - OUTLIER_PERCENTILE], axis=0)
    low[2] = -support_offset_m
    edge_m = EDGE_OVER_EXTENT * max(float((high - low).max()), 1e-3)
    corner = np.array([low[0] - FRONT_MARGIN * edge_m, (low[1] + high[1] - edge_m) / 2, low[2]])
    camera_from_view[:3, 3] = camera_from_view[:3, :3] @ corner
    return Grid(pitch_m=edge_m / GRID_SIZE, camera_from_grid=camera_from_view)


def voxelize_points(points: Points, grid: Grid) -> Occupancy:
    """Mark the voxels that hold at least one of the points (camera frame, metres); points outside are left out."""
    index = np.floor(transform_points(grid.grid_from_camera, points) / np.float32(grid.pitch_m)).astype(np.int32)
    index = index[((index >= 0) & (index < GRID_SIZE)).all(axis=1)]
    occupied = np.zeros((GRID_SIZE,) * 3, bool)
    occupied[index[:, 0], index[:, 1], index[:, 2]] = True
    return occupied


def carve_free(depth_m: DepthImage, intrinsics: Intrinsics, grid: Grid) -> Occupancy:
    """Mark the voxels that some ray crossed before it hit: the reading at the centre's pixel lies behind the voxel."""
    x, y, z = centres_seen_from(grid.camera_from_grid[:3, :3], grid.pitch_m, grid.camera_from_grid[:3, 3])
    if intrinsics.distortion is None:
        with np.errstate(divide="ignore", invalid="ignore"):
            column = x / z * np.float32(intrinsics.fx) + np.float32(intrinsics.cx)
            row = y / z * np.float32(intrinsics.fy) + np.float32(intrinsics.cy)
    else:
        pixels, _ = project(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), intrinsics)
        column, row = pixels[:, 0].reshape(x.shape), pixels[:, 1].reshape(x.shape)
    inside = (z > 0) & (column > -0.5) & (column < intrinsics.width - 0.5)
    inside &= (row > -0.5) & (row < intrinsics.height - 0.5)
    column = np.where(inside, column + np.float32(0.5), 0).astype(np.int32)
    row = np.where(inside, row + np.float32(0.5), 0).astype(np.int32)
    reading = depth_m.ravel()[row * np.int32(intrinsics.width) + column]
    # NaN compares false: where the sensor gave nothing, nothing is known.
    free: Occupancy = inside & (reading > z + np.float32(FREE_MARGIN_VOXELS * grid.pitch_m))
    return free


def cover(occupancy: Occupancy, observed: Occupancy) -> Occupancy:
    """Add the observed voxels that have no filled voxel among their 26 neighbours.

    A surface passes between voxel centres, so about half of the observed voxels belong to the body and half do not;
    filling all of them would fatten it by half a voxel. Farther than one voxel off the body, a measured point shows
    something that the body lacks.
    """
    near = np.pad(occupancy, 1)
    for axis in range(3):
        # One axis after the other makes the 3³ neighbourhood of three short ones.
        first, middle, last = (_slice_along(near, axis, start) for start in range(3))
        near = first | middle | last
    covered: Occupancy = occupancy | (observed & ~near)
    return covered


def voxelize(
    points: Points, depth_m: DepthImage, intrinsics: Intrinsics, up: Vector3, support_offset_m: float
) -> VoxelView:
    """Points of the object and the whole depth image to a view grid with its three kinds of voxels."""
    grid = view_grid(points, up, support_offset_m)
    observed = voxelize_points(points, grid)
    free = carve_free(depth_m, intrinsics, grid) & ~observed
    return VoxelView(grid=grid, observed=observed, free=free)


def _slice_along(padded: Bool[np.ndarray, "x y z"], axis: int, start: int) -> Bool[np.ndarray, "_ _ _"]:
    """The part of one axis that begins at `start` and is as long as the grid."""
    window = [slice(None)] * 3
    window[axis] = slice(start, start + GRID_SIZE)
    return padded[tuple(window)]
