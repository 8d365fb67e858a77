"""One frame of a body: a scene about it, a noisy depth image of that, and what a robot says with it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from service.core.arrays import DepthImage, Mask, Occupancy, Transform, Vector3
from service.core.camera import Intrinsics, pixel_to_point
from service.core.errors import EmptyObject, PhysNetError
from service.core.grids import Grid, invert_rigid
from service.core.segmentation import segment
from service.core.voxels import VoxelView, voxelize
from training.data.views_config import ViewsConfig
from training.metrics import iou
from training.simulation.camera import Rendering, Viewpoint, place_clutter, render, sample_viewpoint
from training.simulation.distance_grid import DistanceGrid
from training.simulation.families import sample_shape
from training.simulation.grid_body import filled
from training.simulation.sensor import apply_sensor
from training.simulation.shapes import Shape

CLUTTER = ("box", "cylinder", "capsule", "superquadric", "blob", "bottle", "jug")
"""What stands about: shapes that are cheap to draw."""

OCCLUDER_TRIES = 8
"""Places and sizes tried for a body that is to hide a part of the object; failing them all it stands alone."""
THUMBNAIL = 4
"""How many times smaller a picture tells how much an occluder hides."""
SMALLEST_OBJECT_PX = 200


@dataclass(frozen=True, eq=False)
class Frame:
    """One noisy depth image, what a robot says with it, and what the service makes of both.

    Attributes:
        viewpoint: Where the camera stood.
        depth_m: What the sensor read.
        hints: The mask, `up` and contact that came with it.
        view: Of the object, in its view grid.
    """

    viewpoint: Viewpoint
    depth_m: DepthImage
    hints: Hints
    view: VoxelView

    @property
    def world_from_grid(self) -> Transform:
        """Pose of the view grid among the bodies."""
        pose: Transform = invert_rigid(self.viewpoint.camera_from_world) @ self.view.grid.camera_from_grid
        return pose

    def truth(self, body: DistanceGrid) -> Occupancy:
        """What a body fills of the view grid."""
        return filled(body, Grid(self.view.grid.pitch_m, self.world_from_grid))


class Hints(NamedTuple):
    """What a robot may say of the object: its pixels, the direction against gravity and a contact, camera frame."""

    mask: Mask | None
    up: Vector3 | None
    contact_m: Vector3 | None


def draw_view(body: DistanceGrid, config: ViewsConfig, rng: np.random.Generator) -> tuple[VoxelView, Occupancy] | None:
    """What the service would make of one frame, and the truth in the same grid; None where it misses the object."""
    frame = draw_frame(body, config, rng)
    if frame is None:
        return None
    return frame.view, frame.truth(body)


def draw_frame(body: DistanceGrid, config: ViewsConfig, rng: np.random.Generator) -> Frame | None:
    """One frame of a body that stands on z = 0; None where the service would miss the object."""
    viewpoint = sample_viewpoint(body.bounds, rng)
    rendering = _scene(Shape("object", body), viewpoint, config, rng)
    if rendering.mask.sum() < SMALLEST_OBJECT_PX:
        return None
    depth_m = apply_sensor(rendering.depth_m, rng, viewpoint.intrinsics.fx, holes_near=rendering.mask)
    try:
        hints = _hints(depth_m, rendering.mask, viewpoint, config, rng)
        found = segment(depth_m, viewpoint.intrinsics, *hints)
    except PhysNetError:
        return None
    seen = rendering.mask & np.isfinite(depth_m)
    if found.support is None or iou(found.pixels, seen) < config.overlap:
        return None
    view = voxelize(found.points, depth_m, viewpoint.intrinsics, found.support.normal, found.support.offset_m)
    return Frame(viewpoint, depth_m, hints, view)


def _scene(shape: Shape, viewpoint: Viewpoint, config: ViewsConfig, rng: np.random.Generator) -> Rendering:
    """The object on its table, alone or with another body."""
    pose, intrinsics = viewpoint
    box = shape.bounds
    table_m = None
    if rng.random() < config.table:
        # The edge lies 0.1 to 1.5 lengths of the object beyond it.
        room = float((box[:, 1] - box[:, 0]).max()) * rng.uniform(0.1, 1.5, (2, 2))
        table_m = (
            float(box[0, 0] - room[0, 0]), float(box[0, 1] + room[0, 1]),
            float(box[1, 0] - room[1, 0]), float(box[1, 1] + room[1, 1]),
        )  # fmt: skip
    clutter: list[Shape] = []
    if rng.random() < config.clutter:
        size_m = float(np.exp(rng.uniform(*np.log(config.size_m))))
        other = sample_shape(CLUTTER[rng.integers(len(CLUTTER))], rng)  # about 1 wide
        other = other.moved(float(rng.uniform(0, np.pi)), size_m)
        if rng.random() < config.occluder:
            clutter = _hiding(shape, other, viewpoint, config, rng)
        else:
            clutter = [place_clutter(shape, other, pose, rng, occlude=False)]
    return render(shape, pose, intrinsics, clutter=clutter, table_m=table_m)


def _hiding(
    shape: Shape, other: Shape, viewpoint: Viewpoint, config: ViewsConfig, rng: np.random.Generator
) -> list[Shape]:
    """The other body where, and as large as, it hides the part of the object that is asked for; none if it cannot."""
    pose, intrinsics = viewpoint
    small = Intrinsics(
        fx=intrinsics.fx / THUMBNAIL, fy=intrinsics.fy / THUMBNAIL, cx=(intrinsics.cx + 0.5) / THUMBNAIL - 0.5,
        cy=(intrinsics.cy + 0.5) / THUMBNAIL - 0.5, width=intrinsics.width // THUMBNAIL,
        height=intrinsics.height // THUMBNAIL,
    )  # fmt: skip
    alone = int(render(shape, pose, small, plane=False).mask.sum())
    for _ in range(OCCLUDER_TRIES):
        placed = place_clutter(shape, other, pose, rng, occlude=True)
        seen = int(render(shape, pose, small, plane=False, clutter=[placed]).mask.sum())
        hidden = 1.0 - seen / max(alone, 1)
        if config.hidden[0] <= hidden <= config.hidden[1]:
            return [placed]
        # A camera that looks down sees over what is low: most bodies drawn at random hide nothing.
        other = other.stretched((1.1, 1.1, 1.5)) if hidden < config.hidden[0] else other.moved(scale=0.8)
    return []


def _hints(
    depth_m: DepthImage, mask: Mask, viewpoint: Viewpoint, config: ViewsConfig, rng: np.random.Generator
) -> Hints:
    """As a robot's request would have them: a mask or else an exact contact, with or without `up`."""
    up = None
    if rng.random() < config.upright:
        up = viewpoint.camera_from_world[:3, 2] + np.radians(rng.uniform(0, 1)) * rng.normal(size=3) / np.sqrt(3)
        up /= np.linalg.norm(up)
    if rng.random() < config.masked:
        return Hints(_frayed(mask, rng), up, None)
    rows, columns = np.nonzero(mask & np.isfinite(depth_m))
    if not len(rows):
        raise EmptyObject("the sensor gave no reading on the object")
    pick = int(rng.integers(len(rows)))
    return Hints(None, up, pixel_to_point(float(columns[pick]), float(rows[pick]), depth_m, viewpoint.intrinsics))


def _frayed(mask: Mask, rng: np.random.Generator) -> Mask:
    """A mask as a detector draws it: grown or shrunk by up to two pixels, and off by one or two."""
    width = int(rng.integers(-2, 3))
    kernel = np.ones((2 * abs(width) + 1,) * 2, np.uint8)
    change = cv2.dilate if width > 0 else cv2.erode
    frayed = np.pad(np.asarray(change(mask.astype(np.uint8), kernel) > 0), 2)
    down, right = rng.integers(0, 5, 2)
    return np.ascontiguousarray(frayed[down : down + mask.shape[0], right : right + mask.shape[1]])
