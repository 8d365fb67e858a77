"""PCA alignment: from the grid a body was reconstructed in to the body grid the deformation network knows."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from service.core.arrays import GRID_SIZE, Matrix3, Occupancy, Probability
from service.core.errors import EmptyObject
from service.core.grids import Grid, invert_rigid

HORIZONTAL_FILL = 0.70
"""Share of the body grid's edge that the body may fill in x and y: the rest is room to deform into."""

VERTICAL_FILL = 0.74
"""The same for its height; the body stands on the floor of the grid, so all the room is above it."""


def body_grid(occupancy: Occupancy, grid: Grid) -> Grid:
    """Align a body whose grid has z up and its floor on the support plane.

    x is the axis of largest variance of the body's horizontal shape, its sign such that the third moment along x is
    not negative; y completes a right-handed frame with z up. The body is centred in x and y and scaled to fill
    `HORIZONTAL_FILL` or `VERTICAL_FILL` of the grid, whichever binds first.

    Raises:
        EmptyObject: No voxel is occupied.
    """
    centres = _occupied_centres(occupancy, grid)
    horizontal = centres[:, :2] - centres[:, :2].mean(axis=0)
    x = _principal_axis(horizontal)
    rotation = np.eye(3)
    rotation[:2, 0] = x
    rotation[:2, 1] = [-x[1], x[0]]
    return _enclosing_grid(centres, grid, rotation, floor=0.0)


def body_grid_free(occupancy: Occupancy, grid: Grid) -> Grid:
    """Align by all three principal axes, where `up` is unknown.

    z is the principal axis nearest to the grid's own z, x the axis of the larger variance among the other two, with
    signs as in `body_grid`; the floor is the lowest occupied voxel.

    Raises:
        EmptyObject: No voxel is occupied.
    """
    centres = _occupied_centres(occupancy, grid)
    centred = centres - centres.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)  # ascending variance, one axis a column
    nearest = int(np.argmax(np.abs(axes[2])))
    z = axes[:, nearest] * np.sign(axes[2, nearest])
    x = axes[:, max(i for i in range(3) if i != nearest)]
    x = x * _third_moment_sign(centred @ x)
    rotation = np.stack([x, np.cross(z, x), z], axis=1)
    return _enclosing_grid(centres, grid, rotation, floor=None)


def resample(probability: Probability, source: Grid, target: Grid) -> Probability:
    """Trilinear lookup of one grid at the voxel centres of another; zero outside the source."""
    target_from_source = invert_rigid(target.camera_from_grid) @ source.camera_from_grid
    source_from_target = invert_rigid(target_from_source)
    scale = target.pitch_m / source.pitch_m
    steps = np.arange(GRID_SIZE) + 0.5
    columns = (source_from_target[:3, :3, None] * steps * scale).astype(np.float32)
    origin = (source_from_target[:3, 3] / source.pitch_m - 0.5).astype(np.float32)
    position = [
        (columns[axis, 0] + origin[axis])[:, None, None] + columns[axis, 1][:, None] + columns[axis, 2]
        for axis in range(3)
    ]
    # One voxel of zeros around the source stands for everything outside.
    padded = np.pad(probability, 1)
    size = GRID_SIZE + 2
    position = [np.clip(p + np.float32(1), 0, np.float32(size - 1.001)) for p in position]
    low = [p.astype(np.int32) for p in position]
    fraction = [p - i for p, i in zip(position, low, strict=True)]
    base = (low[0] * size + low[1]) * size + low[2]
    flat = padded.ravel()

    def along_z(offset: int) -> Float32[np.ndarray, "x y z"]:
        near = flat[base + offset]
        return near + fraction[2] * (flat[base + (offset + 1)] - near)

    def along_y(offset: int) -> Float32[np.ndarray, "x y z"]:
        near = along_z(offset)
        return near + fraction[1] * (along_z(offset + size) - near)

    near = along_y(0)
    result: Probability = near + fraction[0] * (along_y(size * size) - near)
    return result


def _occupied_centres(occupancy: Occupancy, grid: Grid) -> Float32[np.ndarray, "n 3"]:
    centres = (np.argwhere(occupancy).astype(np.float32) + np.float32(0.5)) * np.float32(grid.pitch_m)
    if not len(centres):
        raise EmptyObject("The reconstruction is empty: no voxel of the object is left to align.", field="depth")
    return centres


def _principal_axis(horizontal: Float32[np.ndarray, "n 2"]) -> Float32[np.ndarray, "2"]:
    _, axes = np.linalg.eigh(horizontal.T @ horizontal)
    axis = axes[:, 1]
    return np.asarray(axis * _third_moment_sign(horizontal @ axis), np.float32)


def _third_moment_sign(coordinate: Float32[np.ndarray, "n"]) -> float:
    return 1.0 if float((coordinate.astype(np.float64) ** 3).sum()) >= 0 else -1.0


def _enclosing_grid(
    centres: Float32[np.ndarray, "n 3"], grid: Grid, source_from_body: Matrix3, floor: float | None
) -> Grid:
    """Cube around the occupied voxels, axes as given; `floor` is its lowest z in the source grid's frame."""
    local = centres @ source_from_body.astype(np.float32)
    half = grid.pitch_m / 2
    low, high = local.min(axis=0).astype(np.float64) - half, local.max(axis=0).astype(np.float64) + half
    if floor is not None:
        low[2] = floor
    extent = high - low
    edge_m = float(max(extent[0] / HORIZONTAL_FILL, extent[1] / HORIZONTAL_FILL, extent[2] / VERTICAL_FILL))
    corner = np.array([(low[0] + high[0] - edge_m) / 2, (low[1] + high[1] - edge_m) / 2, low[2]])
    source_from_grid = np.eye(4)
    source_from_grid[:3, :3] = source_from_body
    source_from_grid[:3, 3] = source_from_body @ corner
    return Grid(pitch_m=edge_m / GRID_SIZE, camera_from_grid=grid.camera_from_grid @ source_from_grid)
