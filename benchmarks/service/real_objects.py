"""Real frames of objects whose scanned mesh was fitted to the depth: the reconstruction against the whole object.

    python -m benchmarks.service.real_objects [--out runs/real-objects]

Needs the real frames beside the repository, which are not part of it; some are non-commercial, and so are the pictures
of them: they stay out of the repository too. A pose was fitted by ICP to the frame itself and is good to 1 to 3 mm.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from benchmarks.real_frames import FRAMES, read_frame
from service.core.arrays import Occupancy
from service.core.grids import Grid, invert_rigid
from service.core.materials import Material
from service.core.messages import DeformRequest, EncodedImage, Observation
from service.inference.registry import load_models
from service.picture.raycast import Rgb, view_from_camera
from service.picture.shading import solid
from service.pipeline import Pipeline
from service.settings import Settings
from training.metrics import iou
from training.simulation.distance_grid import RESOLUTION, distance_grid
from training.simulation.grid_body import filled
from training.simulation.mesh import load_triangles

PANEL_PX = 320
RECONSTRUCTED, SCANNED = np.array([0.66, 0.75, 0.86], np.float32), np.array([0.96, 0.80, 0.55], np.float32)
RUBBER = Material(young_modulus_pa=1e5, poisson_ratio=0.4)
"""A question names a material; one without loads makes no use of it."""


@dataclass(frozen=True)
class RealObject:
    """One object in one frame, both shapes in the grid of the answer.

    Attributes:
        frame: Name of the frame.
        name: Name of the mesh.
        grid: The body grid that the service chose.
        reconstruction: What it answered.
        scanned: The scanned mesh in its fitted pose.
    """

    frame: str
    name: str
    grid: Grid
    reconstruction: Occupancy
    scanned: Occupancy

    @property
    def iou(self) -> float:
        """Of the whole body, seen or not."""
        return iou(self.reconstruction, self.scanned)

    def picture(self) -> Rgb:
        """The answer and the scan from the camera's side, on one ground."""
        view = view_from_camera(self.grid.camera_from_grid, self.reconstruction | self.scanned, PANEL_PX, PANEL_PX)
        line_pitch = 0.01 / self.grid.pitch_m
        answer, _ = solid(self.reconstruction, RECONSTRUCTED, view, None, line_pitch)
        scan, _ = solid(self.scanned, SCANNED, view, None, line_pitch)
        return np.concatenate([answer, scan], axis=1)


def real_objects(pipeline: Pipeline) -> Iterator[RealObject]:
    """Every object with a fitted pose, asked with its mask; none where the frames are absent."""
    for path in sorted(FRAMES.glob("*/reference_pose.json")):
        frame = read_frame(path.parent.name)
        depth = EncodedImage("32FC1", np.nan_to_num(frame.depth_m).tobytes())
        for item in json.loads(path.read_text("utf-8"))["objects"]:
            mask = frame.masks[str(item.get("instance_label", "object"))]
            _, png = cv2.imencode(".png", mask.astype(np.uint8) * 255)
            observation = Observation(frame.intrinsics, depth, EncodedImage("png8", png.tobytes()))
            result = pipeline.predict(DeformRequest(observation, RUBBER, ()))
            body = distance_grid(load_triangles(FRAMES.parent / item["mesh"], unit_m=1.0), RESOLUTION)
            mesh_from_grid = invert_rigid(np.array(item["T_camera_from_mesh_m"])) @ result.grid.camera_from_grid
            scanned = filled(body, Grid(result.grid.pitch_m, mesh_from_grid))
            name = Path(item["mesh"]).stem
            yield RealObject(frame.name, name, result.grid, result.reconstruction, scanned)


def main() -> None:
    """Print the table, and draw each object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/real-objects"), help="folder of the pictures")
    given = parser.parse_args()
    models = load_models(Settings().models, threads=1)
    found = list(real_objects(Pipeline(models.reconstruction, models.deformation)))
    if not found:
        raise SystemExit(f"no frame with a fitted pose: {FRAMES}")
    given.out.mkdir(parents=True, exist_ok=True)
    print("| frame | object | IoU |\n|---|---|---|")
    for each in found:
        print(f"| {each.frame} | {each.name} | {each.iou:.3f} |")
        bgr = np.round(255 * np.clip(each.picture()[..., ::-1], 0, 1)).astype(np.uint8)
        cv2.imwrite(str(given.out / f"{each.frame}-{each.name}.png"), bgr)
    print(f"| | mean | {np.mean([each.iou for each in found]):.3f} |")


if __name__ == "__main__":
    main()
