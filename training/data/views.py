"""The `views` set: bodies seen by a noisy depth camera, through the service's own perception.

A draw is held to what a robot may meet, at a tenth of a second a view: the body is sampled once on a grid, from which
its views are rendered and its truth is read.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from service.core.arrays import DepthImage, Mask, Occupancy, Transform, Vector3
from service.core.camera import Intrinsics, pixel_to_point
from service.core.errors import EmptyObject, PhysNetError
from service.core.grids import Grid, invert_rigid, pack_bits
from service.core.segmentation import segment
from service.core.voxels import VoxelView, voxelize
from training.data.generate import Dropped
from training.metrics import iou
from training.simulation.camera import Rendering, Viewpoint, place_clutter, render, sample_viewpoint
from training.simulation.distance_grid import DistanceGrid
from training.simulation.families import FAMILIES, sample_shape
from training.simulation.grid_body import filled, sampled, scaled, tipped
from training.simulation.sensor import apply_sensor
from training.simulation.shapes import Shape
from training.simulation.undercut import stands, undercut

HOLLOW = ("mug", "cup", "bowl", "vase", "tube")
"""Vessels one can look into: their insides and walls are what a view tells least about."""
COMMON = ("box", "rounded_box", "cylinder", "can", "bottle", "carton", "jug", "csg", "blob", "animal")
"""What shelves are full of, and the families that repeat themselves least."""
DRAWN = (*FAMILIES, *HOLLOW, *HOLLOW, *COMMON)
"""Families to draw from: a name that stands twice is drawn twice as often."""
TIPPABLE = ("mug", "cup", "bowl", "vase", "bottle", "can", "cylinder", "jug", "carton")
"""Families that are also met lying, or upside down."""
ROUND_FOOTED = (
    "superquadric", "blob", "csg", "fruit", "dumbbell", "capsule", "plush", "animal", "duck", "crescent", "rounded_box",
    "box", "cylinder", "carton", "can", "bottle", "jug",
)  # fmt: skip
"""Solid families whose foot may be made smaller: what stands about seldom stands on all of its width."""
CLUTTER = ("box", "cylinder", "capsule", "superquadric", "blob", "bottle", "jug")
"""What stands about: shapes that are cheap to draw."""

OCCLUDER_TRIES = 8
"""Places and sizes tried for a body that is to hide a part of the object; failing them all it stands alone."""
THUMBNAIL = 4
"""How many times smaller a picture tells how much an occluder hides."""
SMALLEST_OBJECT_PX = 200
UNDERCUT_TRIES = 4
"""Shares tried, each half of the one before, until a body stands on what is left of its foot."""


@dataclass(frozen=True)
class ViewsConfig:
    """What is drawn for each body.

    Attributes:
        seed: Group i draws from SeedSequence((seed, i)).
        views: Viewpoints on each body.
        thin: Share of bodies with walls and members as thin as real ones.
        thin_hollow: The same of vessels one can look into.
        stretch: Chance that a body is stretched along its axes.
        stretched: Range of each factor, drawn log-uniformly; heights are, and half as much the two widths.
        families: Names to draw from, all alike.
        undercut: Chance that a body of `ROUND_FOOTED` is narrower towards the ground.
        undercut_share: How much on the ground, drawn uniformly.
        undercut_height: Up to where, in units of what half of its lesser width loses, drawn uniformly.
        tipped: Chance that a body of a family that is met so lies on its side, or else stands upside down.
        size_m: Range of the longest edge of the body's box, drawn log-uniformly.
        clutter: Share of views with another body in them.
        occluder: Share of those where it stands before the object and hides a part of it; else it is beside or behind.
        hidden: Range of the part of the object's pixels that an occluder hides.
        table: Share of views where the support plane ends, as tables do; endless otherwise.
        masked: Share of views where a mask comes with the frame; its edge is off by a pixel or two.
        upright: Share of views where `up` is given, off by up to a degree.
        overlap: Least IoU of the segmented pixels with the true ones: another object teaches nothing.
    """

    seed: int = 0
    views: int = 4
    thin: float = 0.4
    thin_hollow: float = 0.65
    stretch: float = 0.5
    stretched: tuple[float, float] = (0.7, 1.4)
    families: tuple[str, ...] = DRAWN
    undercut: float = 0.0
    undercut_share: tuple[float, float] = (0.05, 0.7)
    undercut_height: tuple[float, float] = (0.5, 2.0)
    tipped: float = 0.2
    size_m: tuple[float, float] = (0.05, 0.40)
    clutter: float = 0.25
    occluder: float = 0.5
    hidden: tuple[float, float] = (0.03, 0.6)
    table: float = 0.3
    masked: float = 0.5
    upright: float = 0.6
    overlap: float = 0.5


def draw_group(config: ViewsConfig, index: int) -> dict[str, np.ndarray]:
    """One body with all its views.

    Returns:
        `family`, `thin` (whether its walls are as thin as real ones), `pose` (quarter turns: 0 upright, 1 lying,
        2 upside down), and one row a view of `observed`, `free` and `truth` bits in the view grid, and `sample` (view
        number, longest edge in metres).

    Raises:
        Dropped: There was no body, or none of its views could be segmented.
    """
    rng = np.random.default_rng(np.random.SeedSequence((config.seed, index)))
    family = config.families[rng.integers(len(config.families))]
    thin = bool(rng.random() < (config.thin_hollow if family in HOLLOW else config.thin))
    pose = int(rng.integers(1, 3)) if family in TIPPABLE and rng.random() < config.tipped else 0
    try:
        body = _sized(_stretched(sample_shape(family, rng, thin), config, rng), pose, config, rng)
        if family in ROUND_FOOTED and config.undercut > 0.0 and rng.random() < config.undercut:
            body = _undercut(body, config, rng)
    except (RuntimeError, ValueError) as error:  # none stood in as many tries as it is given, or its walls are lost
        raise Dropped("no_shape") from error
    rows: list[tuple[VoxelView, Occupancy, float]] = []
    for number in range(config.views):
        # A generator of its own for each view: one that fails must not shift the others.
        view = draw_view(body, config, np.random.default_rng(np.random.SeedSequence((config.seed, index, number))))
        if view is not None:
            rows.append((*view, number))
    if not rows:
        raise Dropped("not_segmented")
    return {
        "family": np.array(family),
        "thin": np.array(thin),
        "pose": np.array(pose, np.int8),
        "observed": np.stack([pack_bits(view.observed) for view, _, _ in rows]),
        "free": np.stack([pack_bits(view.free) for view, _, _ in rows]),
        "truth": np.stack([pack_bits(truth) for _, truth, _ in rows]),
        "sample": np.array([[number, _longest(body)] for _, _, number in rows], np.float32),
    }


def _stretched(shape: Shape, config: ViewsConfig, rng: np.random.Generator) -> Shape:
    """The body taller or flatter, and a little wider or narrower."""
    if rng.random() >= config.stretch:
        return shape
    low, high = np.log(config.stretched)
    x, y, z = np.exp(rng.uniform(low, high, 3) * (0.5, 0.5, 1.0))
    return shape.stretched((float(x), float(y), float(z)))


def _sized(shape: Shape, pose: int, config: ViewsConfig, rng: np.random.Generator) -> DistanceGrid:
    """The body sampled on a grid, in its pose and size, on z = 0 about the z axis."""
    grid = tipped(sampled(shape), pose)
    return scaled(grid, float(np.exp(rng.uniform(*np.log(config.size_m)))) / _longest(grid))


def _undercut(body: DistanceGrid, config: ViewsConfig, rng: np.random.Generator) -> DistanceGrid:
    """The body narrower towards the ground as far as it still stands."""
    (left, right), (front, back), (low, high) = body.bounds
    half_m = min(right - left, back - front) / 2
    share, height = rng.uniform(*config.undercut_share), rng.uniform(*config.undercut_height)
    for _ in range(UNDERCUT_TRIES):
        cut = undercut(body, share, min(height * share * half_m, high - low))
        if stands(cut, body):
            return cut
        share /= 2
    return body


def _longest(grid: DistanceGrid) -> float:
    return float((grid.bounds[:, 1] - grid.bounds[:, 0]).max())


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
