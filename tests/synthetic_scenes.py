"""Depth frames of boxes on a table, ray-cast exactly, for tests that need to know every point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.core.camera import Intrinsics, make_intrinsics, ray_grid

CAMERA = make_intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480)


@dataclass(frozen=True)
class Box:
    """An axis-aligned box in the table's frame (z up, table at z = 0), metres."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]


@dataclass(frozen=True)
class TableScene:
    """A rendered frame: depth, which box each pixel shows (−1 table or wall, −2 nothing), and the truth."""

    depth_m: np.ndarray
    shown: np.ndarray
    camera_from_table: np.ndarray

    @property
    def up(self) -> np.ndarray:
        """Unit normal of the table in the camera frame."""
        return self.camera_from_table[:3, 2].copy()

    @property
    def offset_m(self) -> float:
        """Height of the camera above the table."""
        return float(-self.up @ self.camera_from_table[:3, 3])


def render(
    boxes: list[Box],
    *,
    distance_m: float = 0.7,
    pitch_deg: float = 40.0,
    intrinsics: Intrinsics = CAMERA,
    table: tuple[float, float] | None = (2.0, 2.0),
    noise_m: float = 0.0,
    seed: int = 0,
) -> TableScene:
    """Look at the table's origin from `distance_m`, `pitch_deg` below the horizon.

    Args:
        boxes: What stands on the table; a very large flat one makes a wall or a floor.
        distance_m: From the camera to the table's origin.
        pitch_deg: How steeply the camera looks down.
        intrinsics: The camera.
        table: Half extents of the table in x and y; None for no table at all.
        noise_m: Standard deviation of the depth noise.
        seed: Of the noise.
    """
    pitch = np.radians(pitch_deg)
    forward = np.array([0.0, np.cos(pitch), -np.sin(pitch)])
    right = np.array([1.0, 0.0, 0.0])
    table_from_camera = np.eye(4)
    table_from_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward], axis=1)
    table_from_camera[:3, 3] = -distance_m * forward
    x, y = ray_grid(intrinsics)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1).astype(np.float64) @ table_from_camera[:3, :3].T
    origin = table_from_camera[:3, 3]
    nearest = np.full(x.shape, np.inf)
    shown = np.full(x.shape, -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        if table is not None:
            depth = -origin[2] / rays[..., 2]
            hit = origin + depth[..., None] * rays
            on_table = (depth > 0) & (np.abs(hit[..., 0]) < table[0]) & (np.abs(hit[..., 1]) < table[1])
            nearest[on_table], shown[on_table] = depth[on_table], -1
        for index, box in enumerate(boxes):
            entries = (np.stack([np.array(box.low), np.array(box.high)])[:, None, None] - origin) / rays
            enter, leave = entries.min(axis=0).max(axis=-1), entries.max(axis=0).min(axis=-1)
            hit_box = (enter > 0) & (enter <= leave) & (enter < nearest)
            nearest[hit_box], shown[hit_box] = enter[hit_box], index
    depth_m = np.where(np.isfinite(nearest), nearest, np.nan)
    if noise_m:
        depth_m += np.random.default_rng(seed).normal(0.0, noise_m, depth_m.shape)
    camera_from_table = np.linalg.inv(table_from_camera)
    return TableScene(depth_m.astype(np.float32), shown, camera_from_table)
