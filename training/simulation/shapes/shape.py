"""A body that stands on the ground, and the measurements that decide whether it can be simulated."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool
from scipy import ndimage

from service.core.arrays import Points
from training.simulation.shapes.field import (
    AboveGround,
    Bounds,
    Distance,
    Field,
    Intersection,
    Number,
    Stretched,
    Triple,
    axis_rotation,
    place,
)

CHUNK = 1 << 15
"""Points evaluated at a time: a dozen float32 columns of this length stay in the second-level cache."""

TRUSTED_DEPTH = 0.8
"""Part of a field's inner value that is surely clear of the surface: ellipsoids overstate their depth by up to 17 %."""

SAFETY = 1.25
"""The same the other way round: a field value beyond this many radii leaves a ball of that radius on one side."""
BLOCK = 4
"""Voxels along a block that is filled at once if the surface is far enough away."""

FILL_HORIZONTAL = 0.70
FILL_HEIGHT = 0.74
"""Largest part of the body grid's edge that an undeformed body takes; the rest is room to bend into."""


@dataclass(frozen=True)
class Shape:
    """A body standing on z = 0.

    Attributes:
        family: The family it was drawn from.
        field: Its signed distance, in the body's own length unit.
    """

    family: str
    field: Field

    def distance(self, points: Points) -> Distance:
        """Signed distance at n points, negative inside, in the unit of the points."""
        result = np.empty(len(points), np.float32)
        for start in range(0, len(points), CHUNK):
            part = points[start : start + CHUNK]
            x, y, z = (np.ascontiguousarray(part[:, axis]) for axis in range(3))
            result[start : start + CHUNK] = self.field.at(x, y, z)
        return result

    @property
    def bounds(self) -> Bounds:
        """A box that holds the body, [[x low, x high], …]; `tight_bounds` gives the smallest one."""
        return self.field.bounds

    def moved(self, yaw_rad: Number = 0.0, scale: Number = 1.0, translation: Triple = (0.0, 0.0, 0.0)) -> Shape:
        """The body turned about z, then scaled about the origin, then moved."""
        return replace(self, field=place(self.field, axis_rotation("z", yaw_rad), scale, translation))

    def stretched(self, factors: Triple) -> Shape:
        """The body scaled by positive factors along x, y and z about the origin."""
        return replace(self, field=Stretched(self.field, factors))


def to_cube(shape: Shape, yaw_rad: Number, center_xy: tuple[Number, Number], scale: Number) -> Shape:
    """The body in the unit cube of the body grid.

    A point p of the body goes to R_z(yaw) · (p − center)·scale + (0.5, 0.5, 0): yaw and centre are what the
    alignment found, `scale` is 1/L.

    Args:
        shape: A body standing on z = 0.
        yaw_rad: Turn about z that brings its principal axes onto x and y.
        center_xy: The point of the body's own frame that goes to the middle of the cube.
        scale: Cube edges per length unit of the body.
    """
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    x, y = center_xy
    offset = (0.5 - scale * (c * x - s * y), 0.5 - scale * (s * x + c * y), 0.0)
    return shape.moved(yaw_rad, scale, (float(offset[0]), float(offset[1]), 0.0))


def normalise(shape: Shape, yaw_rad: Number = 0.0) -> Shape:
    """The body in the unit cube, its turned box centred and filling 0.70 of the width or 0.74 of the height."""
    turned = shape.moved(yaw_rad)
    box = tight_bounds(turned)
    extent = box[:, 1] - box[:, 0]
    edge = max(extent[0] / FILL_HORIZONTAL, extent[1] / FILL_HORIZONTAL, box[2, 1] / FILL_HEIGHT)
    center = box[:2].mean(axis=1)
    return to_cube(turned, 0.0, (float(center[0]), float(center[1])), float(1 / edge))


def stand(family: str, field: Field, cut: Number = 0.0, box: Bounds | None = None) -> Shape:
    """Put a body on the ground, centred in x and y.

    Args:
        family: Name that the shape will carry.
        field: A body anywhere in space.
        cut: Part of its height, 0 to below 1, that is cut off at the bottom to give a flat foot.
        box: Its tightest box, where that is known; measured otherwise.
    """
    box = tight_bounds(Shape(family, field)) if box is None else box
    low = box[2, 0] + cut * (box[2, 1] - box[2, 0])
    x, y = box[:2].mean(axis=1)
    # A hair below the lowest point, so that flat bottoms lie on z = 0 exactly.
    hair = 1e-4 * (box[2, 1] - box[2, 0])
    return Shape(family, Intersection((place(field, translation=(-x, -y, -low - hair)), AboveGround())))


def sample_points(box: Bounds, counts: tuple[int, int, int]) -> Points:
    """Centres of the cells of a regular grid over a box, in C order of [x, y, z]."""
    axes = [low + (np.arange(n) + 0.5) * (high - low) / n for (low, high), n in zip(box, counts, strict=True)]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)


def voxelize(
    shape: Shape, resolution: int, box: Bounds | None = None
) -> tuple[Bool[np.ndarray, "x y z"], float, Bounds]:
    """Occupancy on cubic voxels over a box (the body's bounds if none is given).

    Args:
        shape: The body.
        resolution: Voxels along the longest edge.
        box: The region to sample.

    Returns:
        The occupancy indexed [x, y, z], the voxel edge, and the region covered, from the box's low corner on.

    Only blocks of voxels that the surface may pass through are sampled voxel by voxel.
    """
    box = shape.bounds if box is None else box
    extent = box[:, 1] - box[:, 0]
    pitch = float(extent.max() / resolution)
    counts = tuple(int(n) for n in np.maximum(np.ceil(extent / pitch - 1e-6), 1))
    region = np.stack([box[:, 0], box[:, 0] + np.array(counts) * pitch], axis=1)
    blocks = tuple(-(-n // BLOCK) for n in counts)
    span = np.stack([box[:, 0], box[:, 0] + np.array(blocks) * BLOCK * pitch], axis=1)
    centres = sample_points(span, (blocks[0], blocks[1], blocks[2]))
    depth = shape.distance(centres)
    occupancy = np.broadcast_to((depth < 0)[:, None], (len(depth), BLOCK**3)).copy()
    mixed = np.abs(depth) <= SAFETY * math.sqrt(3) / 2 * BLOCK * pitch
    half = BLOCK * pitch / 2
    offsets = sample_points(np.array([[-half, half]] * 3), (BLOCK, BLOCK, BLOCK))
    points = (centres[mixed, None] + offsets).reshape(-1, 3)
    occupancy[mixed] = (shape.distance(points) < 0).reshape(-1, BLOCK**3)
    # [block x, y, z, voxel x, y, z] to [x, y, z]
    grid = occupancy.reshape(*blocks, BLOCK, BLOCK, BLOCK).transpose(0, 3, 1, 4, 2, 5)
    grid = grid.reshape([n * BLOCK for n in blocks])[: counts[0], : counts[1], : counts[2]]
    return np.ascontiguousarray(grid), pitch, region


def tight_bounds(shape: Shape, resolution: int = 24) -> Bounds:
    """The smallest box of a body, to about a thousandth of its size; walls thinner than 1/72 of it may be missed.

    Each sample inside the body is the centre of a ball inside the body, whose radius is the depth there; the box of
    these balls lies within the body's own and misses little of it. Samples are taken on a grid, then three times as
    dense where the surface may be, then on slabs along each face.

    Args:
        shape: The body.
        resolution: Samples of the first grid along the longest edge.

    Raises:
        ValueError: If no sample is inside, so the body is empty or far thinner than the sampling.
    """
    outer = shape.bounds
    extent = outer[:, 1] - outer[:, 0]
    counts = np.clip(np.ceil(extent / extent.max() * resolution), 4, None).astype(int)
    points = sample_points(outer, (int(counts[0]), int(counts[1]), int(counts[2])))
    cell = extent / counts
    near = np.abs(shape.distance(points)) <= SAFETY * np.linalg.norm(cell) / 2
    offsets = sample_points(np.stack([-cell / 2, cell / 2], axis=1), (3, 3, 3))
    points = (points[near, None] + offsets).reshape(-1, 3)
    box = _ball_bounds(points, shape.distance(points))
    if box is None:
        raise ValueError(f"no sample lies inside this {shape.family}: is it empty, or thinner than 1/72 of its size?")
    pitch = float(cell.max()) / 3
    for axis in range(3):
        for side in range(2):
            slab = box + np.array([-pitch, pitch])
            slab[axis] = np.clip(box[axis, side] + np.array([-pitch, pitch]), *outer[axis])
            if slab[axis, 0] == slab[axis, 1]:
                continue
            slab_counts = [32] * 3
            slab_counts[axis] = 9
            points = sample_points(slab, (slab_counts[0], slab_counts[1], slab_counts[2]))
            found = _ball_bounds(points, shape.distance(points))
            if found is not None:
                box[axis, side] = (min, max)[side](box[axis, side], found[axis, side])
    return np.stack([np.maximum(box[:, 0], outer[:, 0]), np.minimum(box[:, 1], outer[:, 1])], axis=1)


def _ball_bounds(points: Points, depth: Distance) -> Bounds | None:
    """Box of the balls about those points that lie inside the body; none if none does."""
    inside = depth < 0
    if not inside.any():
        return None
    points, radius = points[inside], -TRUSTED_DEPTH * depth[inside, None]
    return np.stack([(points - radius).min(axis=0), (points + radius).max(axis=0)], axis=1).astype(np.float64)


def min_thickness(shape: Shape, resolution: int = 56, finest: float = 0.04) -> float:
    """Thickness of the thinnest member, as a part of the body grid's edge L.

    The largest t such that balls of diameter t, rolled inside the body, leave no member of it uncovered. A point
    counts as uncovered when it lies more than 0.65 t + one voxel from every such ball: a right-angled corner (0.37 t)
    and a 60° edge (0.5 t) do not, a rod or a plate thinner than t does. Found to
    a voxel: 0.012 L.

    Source: the local thickness of T. Hildebrand and P. Rüegsegger, "A new method for the model-independent assessment
    of thickness in three-dimensional images" (1997), with corners forgiven.

    Args:
        shape: A body standing on z = 0.
        resolution: Voxels along its longest edge.
        finest: Values below this are not told apart.
    """
    box = tight_bounds(shape)
    occupancy, pitch, _ = voxelize(shape, resolution, box)
    extent = box[:, 1] - box[:, 0]
    edge = max(extent[0] / FILL_HORIZONTAL, extent[1] / FILL_HORIZONTAL, extent[2] / FILL_HEIGHT)
    # Depth of a voxel's centre below the surface: half a voxel less than to the nearest empty voxel's centre.
    padded = np.pad(occupancy, 1)
    depth = ndimage.distance_transform_edt(padded) - 0.5
    low, high = 0.0, 2 * float(depth.max()) + 0.5
    while high - low > 0.5:
        middle = (low + high) / 2
        low, high = (middle, high) if _covers(padded, depth, middle / 2) else (low, middle)
        if high * pitch / edge < finest:
            break
    return float((low + high) / 2 * pitch / edge)


def _covers(occupancy: np.ndarray, depth: np.ndarray, radius: float) -> bool:
    """Whether balls of a radius, in voxels, rolled inside the body reach all of it but its corners."""
    # Depths come in halves of a voxel; a quarter more splits the error between odd and even thicknesses.
    centres = depth >= radius - 0.25
    if not centres.any():
        return False
    to_centre = ndimage.distance_transform_edt(~centres)
    return bool((to_centre[occupancy] <= 2.3 * radius + 1.0).all())
