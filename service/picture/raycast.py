"""Renders 64³ grids as lit solids on their support plane: orthographic ray casting in NumPy, no graphics library.

Lengths in this module are in voxels and places in the grid's own frame (voxel (i, j, k) is centred at (i+½, j+½, k+½),
z up, z = 0 the support plane), unless a name carries a unit. Colours are RGB in 0..1, white background.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64

from service.core.arrays import GRID_SIZE, Occupancy, Transform, Vector3

Field = Float32[np.ndarray, "x y z"]
Rgb = Float32[np.ndarray, "rows cols 3"]
Places = Float32[np.ndarray, "n 3"]

SUPERSAMPLING = 2
_STEP = 0.5  # voxels between samples along a ray; half the thinnest thing a grid can hold


@dataclass(frozen=True)
class View:
    """An orthographic camera, the same for every picture of one scene.

    Attributes:
        right, up, toward: Orthonormal axes of the image; `toward` points from the scene to the viewer.
        centre: What stands in the middle of the image.
        half_width, half_height: Half of the image's extent, voxels.
        rows, cols: Pixels of the finished image.
    """

    right: Vector3
    up: Vector3
    toward: Vector3
    centre: Vector3
    half_width: float
    half_height: float
    rows: int
    cols: int

    def project(self, places: Float64[np.ndarray, "n 3"]) -> Float64[np.ndarray, "n 2"]:
        """Places to (column, row) in pixels of the finished image."""
        offset = places - self.centre
        across = (offset @ self.right / self.half_width + 1) * self.cols / 2
        down = (1 - offset @ self.up / self.half_height) * self.rows / 2
        return np.stack([across, down], -1)

    def origins(self) -> Places:
        """Start of every supersampled pixel's ray, outside the grid, row by row."""
        rows, cols = self.rows * SUPERSAMPLING, self.cols * SUPERSAMPLING
        x = ((np.arange(cols) + 0.5) / cols * 2 - 1) * self.half_width
        y = (1 - (np.arange(rows) + 0.5) / rows * 2) * self.half_height
        start = self.centre + 2 * GRID_SIZE * self.toward
        plane = x[None, :, None] * self.right + y[:, None, None] * self.up + start
        return np.asarray(plane.reshape(-1, 3), np.float32)


def view_from_camera(camera_from_grid: Transform, body: Occupancy, rows: int, cols: int) -> View:
    """Look from the depth camera's side, slightly above it, at everything that `body` fills.

    Elevation is the camera's own plus 5°, kept within 20° to 45°, where both height and footprint can be judged.
    """
    filled = np.argwhere(body) + 0.5
    middle = (filled.min(0) + filled.max(0)) / 2 if len(filled) else np.full(3, GRID_SIZE / 2)
    camera = -camera_from_grid[:3, :3].T @ camera_from_grid[:3, 3]
    # Only the direction matters, and the camera stands many grids away: voxel or metre, the azimuth is the same.
    azimuth = math.atan2(camera[1], camera[0]) if np.hypot(camera[0], camera[1]) > 1e-9 else -math.pi / 2
    elevation = math.asin(np.clip(camera[2] / max(float(np.linalg.norm(camera)), 1e-9), -1, 1)) + math.radians(5)
    elevation = float(np.clip(elevation, math.radians(20), math.radians(45)))
    toward = np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )
    right = np.cross([0.0, 0.0, 1.0], toward)
    right /= np.linalg.norm(right)
    up = np.cross(toward, right)
    offset = filled - middle if len(filled) else np.zeros((1, 3))
    reach = max(np.abs(offset @ right).max() / cols, np.abs(offset @ up).max() / rows, 8 / max(rows, cols))
    return View(right, up, toward, middle, 1.45 * reach * cols, 1.45 * reach * rows, rows, cols)


def smooth_field(occupancy: Occupancy) -> Field:
    """A field without the lattice's stairs that is still above ½ in exactly the filled voxels.

    A blur alone would lose walls one voxel thin and shrink what is round. Held away from ½ on either side, the level
    moves by less than a tenth of a voxel on a ball of radius 14, and such a wall keeps 95 % of its area; wider limits
    bring the stairs back.
    """
    sign = np.pad(occupancy, ((4, 4), (4, 4), (0, 4)))
    # The body goes on below the plane it stands on, so that its foot is cut there and not rounded off.
    sign = np.pad(sign, ((0, 0), (0, 0), (4, 0)), mode="edge")
    field = blur(sign.astype(np.float32), 1.3)
    held = np.where(sign, np.maximum(field, 0.58), np.minimum(field, 0.45))
    return np.ascontiguousarray(held[4:-4, 4:-4, 4:-4], np.float32)


def blur(field: Field, sigma: float) -> Field:
    """Gaussian blur, the border value repeated outside; `sigma` in voxels."""
    taps = 2 * math.ceil(2.5 * sigma) + 1
    x, y, z = field.shape
    # OpenCV knows images only: the first axis as the rows of one wide image, then the other two plane by plane.
    along_x = cv2.GaussianBlur(
        field.reshape(x, y * z), (1, taps), sigmaX=sigma, sigmaY=sigma, borderType=cv2.BORDER_REPLICATE
    ).reshape(x, y, z)
    planes = [cv2.GaussianBlur(plane, (taps, taps), sigma, borderType=cv2.BORDER_REPLICATE) for plane in along_x]
    return np.stack(planes).astype(np.float32)


def dilate(occupancy: Occupancy) -> Occupancy:
    """Every voxel with a filled one among its 26 neighbours or itself."""
    wide = np.ones((3, 3), np.uint8)
    along_x = cv2.dilate(occupancy.astype(np.uint8).reshape(GRID_SIZE, -1), wide[:, :1]).reshape(occupancy.shape)
    return np.stack([cv2.dilate(plane, wide) for plane in along_x]).astype(bool)


def sample(field: Field, places: Places) -> Float32[np.ndarray, " n"]:
    """Trilinear interpolation; the border value is repeated outside."""
    top = np.array(field.shape, np.float32) - 1
    at = np.clip(places - np.float32(0.5), 0, top - np.float32(1e-3))
    low = at.astype(np.int32)
    fraction = at - low
    _, size_y, size_z = field.shape
    flat = field.reshape(-1)
    index = (low[:, 0] * size_y + low[:, 1]) * size_z + low[:, 2]
    value = np.zeros(len(places), np.float32)
    for corner in range(8):
        i, j, k = corner >> 2 & 1, corner >> 1 & 1, corner & 1
        weight = (
            (fraction[:, 0] if i else 1 - fraction[:, 0])
            * (fraction[:, 1] if j else 1 - fraction[:, 1])
            * (fraction[:, 2] if k else 1 - fraction[:, 2])
        )
        value += weight * flat[index + (i * size_y + j) * size_z + k]
    return value


def cast(field: Field, view: View) -> tuple[Bool[np.ndarray, " rays"], Places]:
    """Where each supersampled pixel's ray first meets the level ½.

    Returns:
        Whether the ray hits, for every ray, and the place of the hit for those that do.
    """
    origins = view.origins()
    ray = -view.toward.astype(np.float32)
    filled = np.argwhere(field > 0.5)
    hit = np.zeros(len(origins), bool)
    if not len(filled):
        return hit, np.zeros((0, 3), np.float32)
    low, high = np.maximum(filled.min(0) - 1.0, [-1, -1, 0]), filled.max(0) + 2.0
    enter, leave = np.zeros(len(origins), np.float32), np.full(len(origins), np.inf, np.float32)
    for axis in range(3):
        slope = 1 / ray[axis] if abs(ray[axis]) > 1e-6 else np.float32(1e6)
        first, second = (np.float32(side) * slope - origins[:, axis] * slope for side in (low[axis], high[axis]))
        np.maximum(enter, np.minimum(first, second), out=enter)
        np.minimum(leave, np.maximum(first, second), out=leave)
    active = np.flatnonzero(enter < leave)
    distance = enter[active]
    end = leave[active]
    # A cheap look at the dilated body first: most of a ray's way leads through empty space.
    near = dilate(field > 0.5).reshape(-1)
    found_ray, found_at = [], []
    while len(active):
        places = origins[active] + distance[:, None] * ray
        cell = np.clip(places.astype(np.int32), 0, GRID_SIZE - 1)
        close = np.flatnonzero(near[(cell[:, 0] * GRID_SIZE + cell[:, 1]) * GRID_SIZE + cell[:, 2]])
        stop = close[sample(field, places[close]) > 0.5]
        found_ray.append(active[stop])
        found_at.append(distance[stop])
        keep = distance + _STEP < end
        keep[stop] = False
        active, distance, end = active[keep], distance[keep] + np.float32(_STEP), end[keep]
    rays, at = np.concatenate(found_ray), np.concatenate(found_at)
    order = np.argsort(rays)
    rays, at = rays[order], at[order]
    inside, outside = at, at - np.float32(_STEP)
    excess, deficit = (sample(field, origins[rays] + t[:, None] * ray) - np.float32(0.5) for t in (inside, outside))
    for _ in range(2):  # false position: the field is smooth over half a voxel
        share = np.clip(excess / np.maximum(excess - deficit, 1e-6), 0.02, 0.98)
        between = inside + share * (outside - inside)
        value = sample(field, origins[rays] + between[:, None] * ray) - np.float32(0.5)
        above = value > 0
        inside, excess = np.where(above, between, inside), np.where(above, value, excess)
        outside, deficit = np.where(above, outside, between), np.where(above, deficit, value)
    hit[rays] = True
    return hit, origins[rays] + inside[:, None] * ray


def normals(field: Field, places: Places) -> Places:
    """Outward unit normals: the field falls from inside to outside."""
    slope = np.stack([sample(np.ascontiguousarray(axis), places) for axis in np.gradient(blur(field, 1.3))], -1)
    return np.asarray(-slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-9), np.float32)
