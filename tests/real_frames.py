"""Real depth frames and ground-truth scenes kept outside the repository.

They are looked for under `PHYSNET_SHARED`, else `../shared` beside the repository; tests that need them skip with the
path that was missing.
"""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pytest

from service.core.camera import Intrinsics, make_intrinsics

SHARED = Path(os.environ.get("PHYSNET_SHARED", Path(__file__).resolve().parents[2] / "shared"))
FRAMES = SHARED / "data" / "real" / "frames"
SCENES = SHARED / "acceptance" / "scenes"

SINGLE_OBJECT_HEIGHTS_M = {
    "graspnet6dof_sugar": 0.175,
    "graspnet6dof_cylinder": 0.151,
    "graspnet6dof_red_mug": 0.098,
    "graspnet6dof_green_bowl": 0.080,
}
"""Measured height of the object above the table in the frames that show just one."""


@dataclass(frozen=True)
class RealFrame:
    """One frame: depth as the file has it, the camera, and a mask for each object (none where the source has none)."""

    name: str
    intrinsics: Intrinsics
    depth_counts: np.ndarray
    unit_m: float
    masks: dict[str, np.ndarray]

    @property
    def depth_m(self) -> np.ndarray:
        """Float32 metres, NaN where there is no reading."""
        with np.errstate(invalid="ignore"):
            depth_m = self.depth_counts.astype(np.float32) * np.float32(self.unit_m)
            depth_m[~((depth_m > 0) & np.isfinite(depth_m))] = np.nan
        return depth_m


def frames_available() -> bool:
    """Whether the real frames are on this machine."""
    return FRAMES.is_dir()


needs_frames = pytest.mark.skipif(not frames_available(), reason=f"real frames not found: {FRAMES}")
needs_scenes = pytest.mark.skipif(not SCENES.is_dir(), reason=f"acceptance scenes not found: {SCENES}")


@cache
def load_frame(name: str) -> RealFrame:
    """Load one frame; skips the calling test where it is absent."""
    folder = FRAMES / name
    if not folder.is_dir():
        pytest.skip(f"real frame not found: {folder}")
    meta = json.loads((folder / "intrinsics.json").read_text())
    intrinsics = make_intrinsics(*(meta[key] for key in ("fx", "fy", "cx", "cy", "width", "height")))
    if (folder / "depth.npy").exists():
        counts = np.load(folder / "depth.npy", allow_pickle=False).reshape(intrinsics.height, intrinsics.width)
    else:
        counts = np.asarray(cv2.imread(str(folder / "depth.png"), cv2.IMREAD_UNCHANGED))
    return RealFrame(name, intrinsics, counts, meta["depth_unit_m"], _object_masks(folder))


def _object_masks(folder: Path) -> dict[str, np.ndarray]:
    if (folder / "instances.png").exists():
        instances = np.asarray(cv2.imread(str(folder / "instances.png"), cv2.IMREAD_UNCHANGED))
        return {str(label): instances == label for label in np.unique(instances) if label}
    if not (folder / "mask.png").exists():
        return {}
    mask = np.asarray(cv2.imread(str(folder / "mask.png"), cv2.IMREAD_GRAYSCALE)) > 0
    if not folder.name.startswith("cleargrasp"):
        return {"object": mask}
    # These masks hold several objects that stand apart; specks of the annotation are left out.
    count, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8))
    return {str(label): labels == label for label in range(1, count) if stats[label, cv2.CC_STAT_AREA] > 500}


def object_cases(*names: str) -> list[tuple[str, str]]:
    """Pairs (frame, object) of the named frames for parametrised tests; empty where the frames are absent."""
    if not frames_available():
        return []
    return [(name, label) for name in names if (FRAMES / name).is_dir() for label in _object_masks(FRAMES / name)]


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
