"""The `views` set: bodies seen by a noisy depth camera, through the service's own perception."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from service.core.arrays import DepthImage, Mask, Occupancy
from service.core.camera import pixel_to_point
from service.core.errors import EmptyObject, PhysNetError
from service.core.grids import Grid, invert_rigid, pack_bits
from service.core.segmentation import Segment, segment
from service.core.voxels import VoxelView, voxelize
from training.data.body_cube import occupancy_of
from training.data.generate import Dropped
from training.metrics import iou
from training.simulation.camera import Rendering, Viewpoint, place_clutter, render, sample_viewpoint
from training.simulation.families import FAMILIES, sample_shape
from training.simulation.sensor import apply_sensor
from training.simulation.shapes import Shape, tight_bounds

HOLLOW = ("mug", "cup", "bowl", "can", "bottle", "vase", "tube", "jug")
"""Families that are drawn twice as often: their insides and walls are what a view tells least about."""

OCCLUDER_TRIES = 8
"""Places and sizes tried for a body that is to hide a part of the object; failing them all it stands alone."""


@dataclass(frozen=True)
class ViewsConfig:
    """What is drawn for each body.

    Attributes:
        seed: Group i draws from SeedSequence((seed, i)).
        views: Viewpoints on each body.
        thin: Share of bodies with walls as thin as real ones.
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
    views: int = 6
    thin: float = 0.4
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
        `family`, and one row a view of `observed`, `free` and `truth` bits in the view grid, and `sample` (view
        number, longest edge in metres).

    Raises:
        Dropped: No view of the body could be segmented.
    """
    rng = np.random.default_rng(np.random.SeedSequence((config.seed, index)))
    names = FAMILIES + HOLLOW
    family = names[rng.integers(len(names))]
    shape = _sized(sample_shape(family, rng, thin=bool(rng.random() < config.thin)), config, rng)
    rows: list[tuple[VoxelView, Occupancy, float]] = []
    for number in range(config.views):
        # A generator of its own for each view: one that fails must not shift the others.
        view = _draw_view(shape, config, np.random.default_rng(np.random.SeedSequence((config.seed, index, number))))
        if view is not None:
            rows.append((*view, number))
    if not rows:
        raise Dropped("not_segmented")
    size_m = float((shape.bounds[:, 1] - shape.bounds[:, 0]).max())
    return {
        "family": np.array(family),
        "observed": np.stack([pack_bits(view.observed) for view, _, _ in rows]),
        "free": np.stack([pack_bits(view.free) for view, _, _ in rows]),
        "truth": np.stack([pack_bits(truth) for _, truth, _ in rows]),
        "sample": np.array([[number, size_m] for _, _, number in rows], np.float32),
    }


def _sized(shape: Shape, config: ViewsConfig, rng: np.random.Generator) -> Shape:
    box = tight_bounds(shape)
    longest = float((box[:, 1] - box[:, 0]).max())
    size_m = float(np.exp(rng.uniform(*np.log(config.size_m))))
    return shape.moved(scale=size_m / longest)


def _draw_view(shape: Shape, config: ViewsConfig, rng: np.random.Generator) -> tuple[VoxelView, Occupancy] | None:
    """What the service would make of one frame, and the truth in the same grid; None where it misses the object."""
    viewpoint = sample_viewpoint(shape.bounds, rng)
    pose = viewpoint.camera_from_world
    rendering = _scene(shape, viewpoint, config, rng)
    if rendering.mask.sum() < 200:
        return None
    depth_m = apply_sensor(rendering.depth_m, rng, viewpoint.intrinsics.fx, holes_near=rendering.mask)
    try:
        found = _segment(depth_m, rendering.mask, viewpoint, config, rng)
    except PhysNetError:
        return None
    seen = rendering.mask & np.isfinite(depth_m)
    if found.support is None or iou(found.pixels, seen) < config.overlap:
        return None
    view = voxelize(found.points, depth_m, viewpoint.intrinsics, found.support.normal, found.support.offset_m)
    world_from_grid = invert_rigid(pose) @ view.grid.camera_from_grid
    return view, occupancy_of(shape, Grid(view.grid.pitch_m, world_from_grid))


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
    if rng.random() >= config.clutter:
        return render(shape, pose, intrinsics, table_m=table_m)
    other = _sized(sample_shape(FAMILIES[rng.integers(len(FAMILIES))], rng), config, rng)
    if rng.random() >= config.occluder:
        return render(shape, pose, intrinsics, clutter=[place_clutter(shape, other, pose, rng, False)], table_m=table_m)
    alone = render(shape, pose, intrinsics, table_m=table_m)
    for _ in range(OCCLUDER_TRIES):
        hiding = place_clutter(shape, other, pose, rng, occlude=True)
        rendering = render(shape, pose, intrinsics, clutter=[hiding], table_m=table_m)
        hidden = 1.0 - float(rendering.mask.sum()) / max(int(alone.mask.sum()), 1)
        if config.hidden[0] <= hidden <= config.hidden[1]:
            return rendering
        # A camera that looks down sees over what is small: most bodies drawn at random hide nothing.
        other = other.moved(scale=1.5 if hidden < config.hidden[0] else 0.8)
    return alone


def _segment(
    depth_m: DepthImage, mask: Mask, viewpoint: Viewpoint, config: ViewsConfig, rng: np.random.Generator
) -> Segment:
    """Segment as a robot's request would have it: with or without a mask, `up` and an exact contact."""
    up = None
    if rng.random() < config.upright:
        up = viewpoint.camera_from_world[:3, 2] + np.radians(rng.uniform(0, 1)) * rng.normal(size=3) / np.sqrt(3)
        up /= np.linalg.norm(up)
    if rng.random() < config.masked:
        return segment(depth_m, viewpoint.intrinsics, mask=_frayed(mask, rng), up=up)
    rows, columns = np.nonzero(mask & np.isfinite(depth_m))
    if not len(rows):
        raise EmptyObject("the sensor gave no reading on the object")
    pick = int(rng.integers(len(rows)))
    contact_m = pixel_to_point(float(columns[pick]), float(rows[pick]), depth_m, viewpoint.intrinsics)
    return segment(depth_m, viewpoint.intrinsics, up=up, contact_m=contact_m)


def _frayed(mask: Mask, rng: np.random.Generator) -> Mask:
    """A mask as a detector draws it: grown or shrunk by up to two pixels."""
    width = int(rng.integers(-2, 3))
    kernel = np.ones((2 * abs(width) + 1,) * 2, np.uint8)
    change = cv2.dilate if width > 0 else cv2.erode
    return np.asarray(change(mask.astype(np.uint8), kernel) > 0)
