"""PCA alignment: from the grid a body was reconstructed in to the body grid the deformation network knows."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from service.core.arrays import GRID_SIZE, Matrix3, Occupancy, Probability, Vector3
from service.core.errors import EmptyObject
from service.core.grids import Grid, centres_seen_from, filled_voxels, invert_rigid
from service.core.lookup import stacked, trilinear

HORIZONTAL_FILL = 0.70
"""Share of the body grid's edge that the body may fill in x and y: the rest is room to deform into."""

VERTICAL_FILL = 0.74
"""The same for its height; the body stands on the floor of the grid, so all the room is above it."""

PARALLEL = 1.0 - 1e-11
"""Two axes with at least this cosine are one: over a whole grid they part by less than a thousandth of a voxel."""


def body_grid(occupancy: Occupancy, grid: Grid, up: Vector3 | None = None, on_floor: bool = True) -> Grid:
    """Align a body that stands on its support.

    z points against gravity. x is the axis of largest variance of the body's horizontal shape, its sign such that the
    third moment along x is not negative; y completes a right-handed frame. The body is centred in x and y and scaled
    to fill `HORIZONTAL_FILL` or `VERTICAL_FILL` of the grid, whichever binds first.

    Args:
        occupancy: The body.
        grid: Where its voxels are.
        up: Direction against gravity in the camera frame; None for the z axis of `grid`.
        on_floor: Whether the floor of `grid` is the support plane; else the body's lowest voxel stands on it.

    Raises:
        EmptyObject: No voxel is occupied.
    """
    centres = _occupied_centres(occupancy, grid)
    grid_from_upright = np.eye(3)
    horizontal = centres[:2]
    if up is not None:
        grid_from_upright = _rotation_with_z(grid.camera_from_grid[:3, :3].T @ up)
        horizontal = grid_from_upright[:, :2].T.astype(np.float32) @ centres
    x = _principal_axis(horizontal - horizontal.mean(axis=1, keepdims=True))
    upright_from_body = np.array([[x[0], -x[1], 0.0], [x[1], x[0], 0.0], [0.0, 0.0, 1.0]])
    return _enclosing_grid(centres, grid, grid_from_upright @ upright_from_body, on_floor)


def body_grid_free(occupancy: Occupancy, grid: Grid) -> Grid:
    """Align by all three principal axes, where `up` is unknown.

    z is the principal axis nearest to the grid's own z, x the axis of the larger variance among the other two, with
    signs as in `body_grid`; the floor is the lowest occupied voxel.

    Raises:
        EmptyObject: No voxel is occupied.
    """
    centres = _occupied_centres(occupancy, grid)
    centred = centres - centres.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(centred @ centred.T)  # ascending variance, one axis a column
    nearest = int(np.argmax(np.abs(axes[2])))
    z = axes[:, nearest] * np.sign(axes[2, nearest])
    x = axes[:, max(i for i in range(3) if i != nearest)]
    x = x * _third_moment_sign(x @ centred)
    rotation = np.stack([x, np.cross(z, x), z], axis=1).astype(np.float64)
    return _enclosing_grid(centres, grid, rotation, on_floor=False)


def resample(probability: Probability, source: Grid, target: Grid) -> Probability:
    """Trilinear lookup of one grid at the voxel centres of another; zero outside the source."""
    source_from_target = invert_rigid(source.camera_from_grid) @ target.camera_from_grid
    rotation, pitch = source_from_target[:3, :3], target.pitch_m / source.pitch_m
    origin = source_from_target[:3, 3] / source.pitch_m - 0.5
    if rotation[2, 2] < PARALLEL:
        return trilinear(probability, *centres_seen_from(rotation, pitch, origin))
    # Both stand upright: the centres above each other stay above each other.
    steps = (np.arange(GRID_SIZE) + 0.5) * pitch
    x, y = (
        ((rotation[axis, 0] * steps + origin[axis])[:, None] + rotation[axis, 1] * steps).astype(np.float32)
        for axis in (0, 1)
    )
    return stacked(probability, x, y, steps + origin[2])


def _occupied_centres(occupancy: Occupancy, grid: Grid) -> Float32[np.ndarray, "axis=3 n"]:
    centres = filled_voxels(occupancy).astype(np.float32)
    if centres.shape[1] == 0:
        raise EmptyObject("The reconstruction is empty: no voxel of the object is left to align.", field="depth")
    centres += np.float32(0.5)
    centres *= np.float32(grid.pitch_m)
    return centres


def _principal_axis(horizontal: Float32[np.ndarray, "axis=2 n"]) -> Float32[np.ndarray, "2"]:
    _, axes = np.linalg.eigh(horizontal @ horizontal.T)
    axis = axes[:, 1]
    return np.asarray(axis * _third_moment_sign(axis @ horizontal), np.float32)


def _third_moment_sign(coordinate: Float32[np.ndarray, "n"]) -> float:
    exact = coordinate.astype(np.float64)
    return 1.0 if float((exact * exact) @ exact) >= 0 else -1.0


def _rotation_with_z(z: Vector3) -> Matrix3:
    """Some rotation whose third column is z."""
    z = z / np.linalg.norm(z)
    helper = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = helper - (helper @ z) * z
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _enclosing_grid(
    centres: Float32[np.ndarray, "axis=3 n"], grid: Grid, source_from_body: Matrix3, on_floor: bool
) -> Grid:
    """Cube around the occupied voxels with the given axes, its bottom on the source's floor or the lowest voxel."""
    local = source_from_body.T.astype(np.float32) @ centres
    half = grid.pitch_m / 2
    low, high = local.min(axis=1).astype(np.float64) - half, local.max(axis=1).astype(np.float64) + half
    if on_floor:
        low[2] = 0.0
    extent = high - low
    edge_m = float(max(extent[0] / HORIZONTAL_FILL, extent[1] / HORIZONTAL_FILL, extent[2] / VERTICAL_FILL))
    corner = np.array([(low[0] + high[0] - edge_m) / 2, (low[1] + high[1] - edge_m) / 2, low[2]])
    source_from_grid = np.eye(4)
    source_from_grid[:3, :3] = source_from_body
    source_from_grid[:3, 3] = source_from_body @ corner
    return Grid(pitch_m=edge_m / GRID_SIZE, camera_from_grid=grid.camera_from_grid @ source_from_grid)
