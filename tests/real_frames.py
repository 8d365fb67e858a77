"""Real depth frames and ground-truth scenes kept outside the repository, see `benchmarks.real_frames`.

Tests that need them skip with the path that was missing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

from benchmarks.real_frames import FRAMES, SHARED, RealFrame, object_masks, read_frame
from service.core.camera import Intrinsics, make_intrinsics

SCENES = SHARED / "acceptance" / "scenes"

SINGLE_OBJECT_HEIGHTS_M = {
    "graspnet6dof_sugar": 0.175,
    "graspnet6dof_cylinder": 0.151,
    "graspnet6dof_red_mug": 0.098,
    "graspnet6dof_green_bowl": 0.080,
}
"""Measured height of the object above the table in the frames that show just one."""


def frames_available() -> bool:
    """Whether the real frames are on this machine."""
    return FRAMES.is_dir()


needs_frames = pytest.mark.skipif(not frames_available(), reason=f"real frames not found: {FRAMES}")
needs_scenes = pytest.mark.skipif(not SCENES.is_dir(), reason=f"acceptance scenes not found: {SCENES}")


@cache
def load_frame(name: str) -> RealFrame:
    """Load one frame; skips the calling test where it is absent."""
    if not (FRAMES / name).is_dir():
        pytest.skip(f"real frame not found: {FRAMES / name}")
    return read_frame(name)


def object_cases(*names: str) -> list[tuple[str, str]]:
    """Pairs (frame, object) of the named frames for parametrised tests; empty where the frames are absent."""
    if not frames_available():
        return []
    return [(name, label) for name in names if (FRAMES / name).is_dir() for label in object_masks(FRAMES / name)]


@dataclass(frozen=True)
class Scene:
    """A rendered depth frame with its ground truth; `support_plane` is (unit normal, offset), n·p + offset = height."""

    name: str
    intrinsics: Intrinsics
    depth_counts: np.ndarray
    mask: np.ndarray
    up: np.ndarray
    contact_m: np.ndarray
    camera_from_grid: np.ndarray

    @property
    def depth_m(self) -> np.ndarray:
        """Float32 metres, NaN where there is no reading."""
        depth_m = self.depth_counts.astype(np.float32) * np.float32(0.001)
        depth_m[self.depth_counts == 0] = np.nan
        return depth_m

    @property
    def support_plane(self) -> tuple[np.ndarray, float]:
        """The plane z = 0 of the grid: unit normal and offset in the camera frame."""
        normal = self.camera_from_grid[:3, 2]
        return normal, float(-normal @ self.camera_from_grid[:3, 3])


def scene_names() -> list[str]:
    """Names of all acceptance scenes, empty where they are absent."""
    return sorted(path.stem for path in SCENES.glob("*.npz"))


@cache
def load_scene(name: str) -> Scene:
    """Load one acceptance scene."""
    data = np.load(SCENES / f"{name}.npz")
    k = data["K"]
    height, width = data["depth"].shape
    intrinsics = make_intrinsics(k[0, 0], k[1, 1], k[0, 2], k[1, 2], width, height)
    return Scene(name, intrinsics, data["depth"], data["mask"], data["up"], data["contact_m"], data["camera_from_grid"])
