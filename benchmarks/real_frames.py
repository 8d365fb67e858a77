"""Real depth frames kept outside the repository: under `PHYSNET_SHARED`, else in `../shared` beside it."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from service.core.camera import Intrinsics, make_intrinsics

SHARED = Path(os.environ.get("PHYSNET_SHARED", Path(__file__).resolve().parents[2] / "shared"))
FRAMES = SHARED / "data" / "real" / "frames"


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


def read_frame(name: str) -> RealFrame:
    """One frame by the name of its folder.

    Raises:
        FileNotFoundError: It is not there.
    """
    folder = FRAMES / name
    meta = json.loads((folder / "intrinsics.json").read_text("utf-8"))
    intrinsics = make_intrinsics(*(meta[key] for key in ("fx", "fy", "cx", "cy", "width", "height")))
    if (folder / "depth.npy").exists():
        counts = np.load(folder / "depth.npy", allow_pickle=False).reshape(intrinsics.height, intrinsics.width)
    else:
        counts = np.asarray(cv2.imread(str(folder / "depth.png"), cv2.IMREAD_UNCHANGED))
    return RealFrame(name, intrinsics, counts, meta["depth_unit_m"], object_masks(folder))


def object_masks(folder: Path) -> dict[str, np.ndarray]:
    """A mask for each object of the frame in a folder; none where its source has none."""
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
