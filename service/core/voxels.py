"""From segmented points to a 64³ grid whose voxels are observed, free or unknown."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from service.core.arrays import GRID_SIZE, DepthImage, Occupancy, Points, Transform, Vector3
from service.core.camera import Intrinsics, project
from service.core.grids import Grid, centres_seen_from

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

SLAB = 512
"""Columns of voxels carved at once: what is computed for them stays in the processor's cache."""

LONGEST_REMAP = 2**15 - 1
"""OpenCV looks pixels up in images shorter and narrower than this."""

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
        be higher still. One layer is left for readings that are missing along the rim.
        """
        seen = np.flatnonzero(self.observed.any(axis=(0, 1)))
        if len(seen) == 0:
            return GRID_SIZE
        above = int(seen[-1]) + 1
        camera_height = float(self.grid.grid_from_camera[2, 3]) / self.grid.pitch_m
        return min(above + 1, GRID_SIZE) if camera_height > above else GRID_SIZE


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
    local = np.sort(camera_from_view[:3, :3].T.astype(np.float32) @ points.T, axis=1)
    low, high = (_percentile(local, percentile) for percentile in (OUTLIER_PERCENTILE, 100.0 - OUTLIER_PERCENTILE))
    low[2] = -support_offset_m
    edge_m = EDGE_OVER_EXTENT * max(float((high - low).max()), 1e-3)
    corner = np.array([low[0] - FRONT_MARGIN * edge_m, (low[1] + high[1] - edge_m) / 2, low[2]])
    camera_from_view[:3, 3] = camera_from_view[:3, :3] @ corner
    return Grid(pitch_m=edge_m / GRID_SIZE, camera_from_grid=camera_from_view)


def voxelize_points(points: Points, grid: Grid) -> Occupancy:
    """Mark the voxels that hold at least one of the points (camera frame, metres); points outside are left out."""
    grid_from_camera = grid.grid_from_camera
    local = grid_from_camera[:3, :3].astype(np.float32) @ points.T
    local += grid_from_camera[:3, 3:].astype(np.float32)
    local /= np.float32(grid.pitch_m)
    index = np.floor(local, out=local).astype(np.int32)
    # As unsigned, what lies below zero is far above the grid.
    inside = (index.view(np.uint32) < GRID_SIZE).all(axis=0)
    voxel = (index[0] * GRID_SIZE + index[1]) * GRID_SIZE + index[2]
    occupied = np.zeros(GRID_SIZE**3, bool)
    occupied[voxel[inside]] = True
    return occupied.reshape((GRID_SIZE,) * 3)


def carve_free(depth_m: DepthImage, intrinsics: Intrinsics, grid: Grid) -> Occupancy:
    """Mark the voxels that some ray crossed before it hit: the reading at the centre's pixel lies behind the voxel."""
    if intrinsics.distortion is not None:
        centres = centres_seen_from(grid.camera_from_grid[:3, :3], grid.pitch_m, grid.camera_from_grid[:3, 3])
        x, y, z = (axis.reshape(-1, GRID_SIZE) for axis in centres)
        pixels, _ = project(np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1), intrinsics)
        column, row = pixels.T.astype(np.float32).reshape(2, *x.shape)
        return _hits_behind(depth_m, column, row, z, grid.pitch_m).reshape((GRID_SIZE,) * 3)
    # u z, v z and z are linear in the three indices of a voxel: a share for each (i, j) and one for each k.
    along = intrinsics.matrix @ grid.camera_from_grid[:3, :3] * grid.pitch_m
    first = intrinsics.matrix @ grid.camera_from_grid[:3, 3] + along.sum(axis=1) / 2
    steps = np.arange(GRID_SIZE)
    of_column = first[:, None, None] + along[:, 0, None, None] * steps[:, None] + along[:, 1, None, None] * steps
    of_column = of_column.astype(np.float32).reshape(3, -1, 1)
    of_step = (along[:, 2:] * steps).astype(np.float32)[:, None]
    free = np.empty((GRID_SIZE**2, GRID_SIZE), bool)
    for start in range(0, GRID_SIZE**2, SLAB):
        slab = slice(start, start + SLAB)
        column, row, z = of_column[:, slab] + of_step
        with np.errstate(divide="ignore", invalid="ignore"):
            column /= z
            row /= z
        free[slab] = _hits_behind(depth_m, column, row, z, grid.pitch_m)
    return free.reshape((GRID_SIZE,) * 3)


def _hits_behind(
    depth_m: DepthImage,
    column: Float32[np.ndarray, "rows columns"],
    row: Float32[np.ndarray, "rows columns"],
    z: Float32[np.ndarray, "rows columns"],
    pitch_m: float,
) -> Bool[np.ndarray, "rows columns"]:
    """Whether the reading at each pixel lies behind a voxel whose centre is seen there at depth z."""
    if max(depth_m.shape) < LONGEST_REMAP:
        reading = cv2.remap(depth_m, column, row, cv2.INTER_NEAREST, None, cv2.BORDER_CONSTANT, float("nan"))
    else:
        inside = (column > -0.5) & (column < depth_m.shape[1] - 0.5) & (row > -0.5) & (row < depth_m.shape[0] - 0.5)
        pixel = tuple(np.rint(np.where(inside, place, 0.0)).astype(np.intp) for place in (row, column))
        reading = np.where(inside, depth_m[pixel], np.float32(np.nan))
    # NaN compares false: where the sensor gave nothing, nothing is known.
    behind = reading > z + np.float32(FREE_MARGIN_VOXELS * pitch_m)
    # What is behind the camera appears in the image, too, upside down.
    return np.asarray(behind & (z > 0.0), np.bool_)


def cover(occupancy: Occupancy, observed: Occupancy) -> Occupancy:
    """Add the observed voxels that have no filled voxel among their 26 neighbours.

    A surface passes between voxel centres, so about half of the observed voxels belong to the body and half do not;
    filling all of them would fatten it by half a voxel. Farther than one voxel off the body, a measured point shows
    something that the body lacks.
    """
    # One axis after the other makes the 3³ neighbourhood of three short ones; z is OpenCV's, since NumPy's loop over
    # short rows takes longer than all the rest.
    columns = occupancy.view(np.uint8).reshape(-1, GRID_SIZE)
    near = cv2.dilate(columns, np.ones((1, 3), np.uint8)).view(np.bool_).reshape(occupancy.shape)
    for axis in (1, 0):
        wider = near.copy()
        there, here = np.moveaxis(wider, axis, 0), np.moveaxis(near, axis, 0)
        there[:-1] |= here[1:]
        there[1:] |= here[:-1]
        near = wider
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


def _percentile(ascending: Float32[np.ndarray, "axis=3 n"], percentile: float) -> Float64[np.ndarray, "axis=3"]:
    """As `np.percentile` of each row, which is not told that they are sorted."""
    place = percentile / 100.0 * (ascending.shape[1] - 1)
    below = int(place)
    above = min(below + 1, ascending.shape[1] - 1)
    share = place - below
    return np.asarray((1.0 - share) * ascending[:, below] + share * ascending[:, above], np.float64)
