"""Depth frames of a box on a table, computed in closed form: no renderer, no data, exact to the millimetre."""

from __future__ import annotations

import base64
import io
import json
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np

from service.api import convert
from service.core.messages import DeformRequest


@dataclass(frozen=True)
class BoxScene:
    """A box standing on a table in front of a camera that looks down on it.

    World: z up, origin on the table under the box. The camera looks at the middle of the box.
    """

    width: int = 320
    height: int = 240
    focal_px: float = 300.0
    size_m: tuple[float, float, float] = (0.10, 0.08, 0.14)
    distance_m: float = 0.60
    elevation_rad: float = 0.70
    yaw_rad: float = 0.0
    aim_offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    table_half_m: float = 5.0
    _cache: dict[str, Any] = field(default_factory=dict, init=False, compare=False, repr=False)

    @property
    def camera(self) -> dict[str, Any]:
        return {
            "fx": self.focal_px,
            "fy": self.focal_px,
            "cx": (self.width - 1) / 2,
            "cy": (self.height - 1) / 2,
            "width": self.width,
            "height": self.height,
        }

    @property
    def world_from_camera(self) -> np.ndarray:
        forward = -np.array([0.0, -np.cos(self.elevation_rad), np.sin(self.elevation_rad)])
        right = np.array([1.0, 0.0, 0.0])
        pose = np.eye(4)
        pose[:3, :3] = np.column_stack([right, np.cross(forward, right), forward])
        middle = np.array([0.0, 0.0, self.size_m[2] / 2]) + self.aim_offset_m
        pose[:3, 3] = middle - self.distance_m * forward
        return pose

    @property
    def camera_from_world(self) -> np.ndarray:
        return np.linalg.inv(self.world_from_camera)

    @property
    def up(self) -> list[float]:
        """Against gravity, camera frame."""
        return self.camera_from_world[:3, 2].tolist()

    def in_camera(self, point_m: tuple[float, float, float]) -> list[float]:
        """A world point in the camera frame."""
        return (self.camera_from_world @ [*point_m, 1.0])[:3].tolist()

    def pixel(self, point_m: tuple[float, float, float]) -> list[float]:
        x, y, z = self.in_camera(point_m)
        camera = self.camera
        return [camera["fx"] * x / z + camera["cx"], camera["fy"] * y / z + camera["cy"]]

    def direction(self, vector: tuple[float, float, float]) -> list[float]:
        """A world direction in the camera frame."""
        return (self.camera_from_world[:3, :3] @ vector).tolist()

    def render(self) -> tuple[np.ndarray, np.ndarray]:
        """Depth in metres (NaN beyond the table) and the box's mask."""
        if "render" not in self._cache:
            self._cache["render"] = self._render()
        return self._cache["render"]

    def _render(self) -> tuple[np.ndarray, np.ndarray]:
        camera = self.camera
        v, u = np.indices((self.height, self.width), dtype=np.float64)
        rays = np.stack([(u - camera["cx"]) / camera["fx"], (v - camera["cy"]) / camera["fy"], np.ones_like(u)], -1)
        pose = self.world_from_camera
        origin, rays = pose[:3, 3], rays @ pose[:3, :3].T
        with np.errstate(divide="ignore", invalid="ignore"):
            table = -origin[2] / rays[..., 2]
            spot = origin + table[..., None] * rays
            on_table = (table > 0) & (np.abs(spot[..., :2]) <= self.table_half_m).all(-1)
            c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
            box_from_world = np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
            start, step = box_from_world @ origin, rays @ box_from_world.T
            half = np.array(self.size_m) / 2
            low, high = np.array([-half[0], -half[1], 0.0]), np.array([half[0], half[1], self.size_m[2]])
            first, second = (low - start) / step, (high - start) / step
            enter, leave = np.minimum(first, second).max(-1), np.maximum(first, second).min(-1)
        hit = (enter < leave) & (enter > 0)
        depth_m = np.where(on_table, table, np.nan)
        box = hit & ~(depth_m < enter)
        # Rays have z = 1 in the camera frame, so their parameter is the depth.
        return np.where(box, enter, depth_m), box

    def counts(self) -> np.ndarray:
        """Depth as uint16 millimetres, 0 for no reading."""
        depth_m, _ = self.render()
        return np.rint(np.nan_to_num(depth_m) * 1000).astype(np.uint16)

    def depth_png(self) -> bytes:
        return png(self.counts())

    def mask_png(self) -> bytes:
        return png(self.render()[1].astype(np.uint8) * 255)

    def top_m(self) -> tuple[float, float, float]:
        """Middle of the top face, world."""
        return (0.0, 0.0, self.size_m[2])

    def front_m(self, height: float = 0.7) -> tuple[float, float, float]:
        """A point of the face towards the camera, world (for no yaw)."""
        return (0.0, -self.size_m[1] / 2, height * self.size_m[2])

    def request(self, **changes: Any) -> dict[str, Any]:
        """A request as JSON: press on the front, along +y of the world, with all that is optional left out."""
        body: dict[str, Any] = {
            "camera": self.camera,
            "depth": {"encoding": "png16", "unit_m": 0.001, "data": b64(self.depth_png())},
            "material": {"young_modulus_pa": 1e5, "poisson_ratio": 0.45},
            "loads": [{"contact_m": self.in_camera(self.front_m()), "force_n": self.direction((0.0, 4.0, 0.0))}],
        }
        body |= changes
        return {key: value for key, value in body.items() if value is not ...}


def asked(body: dict[str, Any], files: dict[str, bytes] | None = None, max_loads: int = 8) -> DeformRequest:
    """What the pipeline is asked where a document, and files beside it, are posted."""
    return convert.deform_request(convert.parse_body(json.dumps(body).encode()), max_loads, files)


def png(image: np.ndarray) -> bytes:
    ok, data = cv2.imencode(".png", image)
    assert ok
    return data.tobytes()


def npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def b64(data: bytes) -> str:
    return base64.b64encode(data).decode()


def grid(document: dict[str, str]) -> np.ndarray:
    """Occupancy of a reply's `bits`."""
    assert document["encoding"] == "bits"
    data = np.frombuffer(base64.b64decode(document["data"]), np.uint8)
    assert len(data) == 64**3 // 8
    return np.unpackbits(data, bitorder="little").reshape(64, 64, 64).astype(bool)


def box_shape(fill: float = 0.5) -> dict[str, Any]:
    """A known shape: a block on the floor of its grid, 0.2 m grid edge, 0.6 m in front of the camera."""
    occupancy = np.zeros((64, 64, 64), bool)
    low, high = int(32 - 32 * fill), int(32 + 32 * fill)
    occupancy[low:high, low:high, : high - low] = True
    pitch_m = 0.2 / 64
    camera_from_grid = np.array(
        [[1.0, 0.0, 0.0, -0.1], [0.0, 0.0, -1.0, 0.1], [0.0, 1.0, 0.0, 0.5], [0.0, 0.0, 0.0, 1.0]]
    )
    return {
        "encoding": "bits",
        "data": b64(np.packbits(occupancy.ravel(), bitorder="little").tobytes()),
        "voxel_size_m": pitch_m,
        "camera_from_grid": camera_from_grid.tolist(),
    }
