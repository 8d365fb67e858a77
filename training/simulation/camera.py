"""A depth camera that looks at bodies on a support plane.

Pixel (u, v) looks along ((u − cx)/fx, (v − cy)/fy, 1) in the optical frame (x right, y down, z forward); depth is the
z of the first surface met. Bodies live in the world frame, metres, z up, support plane z = 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from service.core.arrays import DepthImage, Mask, Points, Transform, Vector3
from service.core.camera import Intrinsics
from service.core.grids import invert_rigid
from training.simulation.distance_grid import DistanceGrid
from training.simulation.grid_body import trace_grid
from training.simulation.shapes import Bounds, Shape
from training.simulation.shapes.field import Number
from training.simulation.trace import trace

FARTHEST_M = 6.0
"""Readings beyond this range are dropped, as depth cameras do."""


class Rendering(NamedTuple):
    """Depth in metres, NaN where nothing is seen, and the pixels where the object is what is seen."""

    depth_m: DepthImage
    mask: Mask


class Viewpoint(NamedTuple):
    """Where a camera stands: its pose and its intrinsics."""

    camera_from_world: Transform
    intrinsics: Intrinsics


def render(
    shape: Shape,
    camera_from_world: Transform,
    intrinsics: Intrinsics,
    plane: bool = True,
    clutter: Sequence[Shape] = (),
    farthest_m: Number = FARTHEST_M,
    table_m: tuple[Number, Number, Number, Number] | None = None,
) -> Rendering:
    """Depth image of a body on its support.

    Args:
        shape: The object, in the world frame.
        camera_from_world: Rigid transform.
        intrinsics: Of the camera.
        plane: Whether the support plane z = 0 is there.
        clutter: Other bodies in the scene; the mask leaves out what they hide.
        farthest_m: Range of the camera along z.
        table_m: Where the support plane ends: lowest x, highest x, lowest y, highest y; endless if not given.
    """
    size = (intrinsics.height, intrinsics.width)
    depth = _plane_depth(camera_from_world, intrinsics, table_m) if plane else np.full(size, np.inf, np.float32)
    mask = np.zeros(size, bool)
    for body in (*clutter, shape):
        window = _window(body.bounds, camera_from_world, intrinsics)
        if window is None:
            continue
        rows, columns = window
        behind = depth[rows, columns]
        if isinstance(body.field, DistanceGrid):
            found = trace_grid(body.field, camera_from_world, intrinsics, rows, columns, behind)
        else:
            found = trace(body, camera_from_world, intrinsics, rows, columns, behind)
        nearer = found < behind
        behind[nearer] = found[nearer]
        mask[rows, columns] = nearer if body is shape else mask[rows, columns] & ~nearer
    depth[~(depth <= farthest_m)] = np.nan
    return Rendering(depth, mask & np.isfinite(depth))


def look_at(eye_m: Sequence[Number], target_m: Sequence[Number], roll_rad: Number = 0.0) -> Transform:
    """Pose of a camera at `eye_m` that looks at `target_m` with its x axis level, then rolled about its view.

    Raises:
        ValueError: If it would look straight up or down, where "level" has no meaning.
    """
    eye, forward = np.array(eye_m, np.float64), np.array(target_m, np.float64) - np.array(eye_m, np.float64)
    forward /= np.linalg.norm(forward)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    if np.linalg.norm(right) < 1e-6:
        raise ValueError("the camera looks straight along z; tilt it a little")
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    c, s = math.cos(roll_rad), math.sin(roll_rad)
    rotation = np.stack([c * right + s * down, -s * right + c * down, forward])
    camera_from_world = np.eye(4)
    camera_from_world[:3, :3] = rotation
    camera_from_world[:3, 3] = -rotation @ eye
    return camera_from_world


def direction(elevation_rad: Number, azimuth_rad: Number) -> Vector3:
    """Unit vector towards a place at an elevation above the ground and an azimuth from the x axis."""
    level = math.cos(elevation_rad)
    return np.array([level * math.cos(azimuth_rad), level * math.sin(azimuth_rad), math.sin(elevation_rad)])


def sample_viewpoint(bounds: Bounds, rng: np.random.Generator, width: int = 640, height: int = 480) -> Viewpoint:
    """A camera somewhere around a body, as a robot's would be.

    Elevation 5° to 85°, mostly 15° to 60°; any azimuth; a roll of a few degrees; fx ≈ fy in 500 to 920 for a width of
    640; at a distance from which the body spans 60 to 260 pixels, off the image centre by chance but wholly inside
    the frame.

    Args:
        bounds: Box of the body in the world frame, metres.
        rng: Source of randomness.
        width: Of the image in pixels.
        height: Of the image in pixels.
    """
    center, extent = bounds.mean(axis=1), bounds[:, 1] - bounds[:, 0]
    zoom = width / 640
    focal = zoom * rng.uniform(500, 920)
    intrinsics = Intrinsics(
        fx=focal,
        fy=focal * rng.uniform(0.995, 1.005),
        cx=width / 2 + zoom * rng.normal(0, 6),
        cy=height / 2 + zoom * rng.normal(0, 6),
        width=width,
        height=height,
    )
    narrow = rng.random() < 0.8
    elevation = math.radians(rng.uniform(15, 60) if narrow else rng.uniform(5, 85))
    azimuth = rng.uniform(0, 2 * math.pi)
    toward_eye = direction(elevation, azimuth)
    pixels = zoom * rng.uniform(60, 260)
    # The diagonal bounds what is seen from any side; bodies are seen smaller than that, hence the factor.
    span = 0.85 * float(np.linalg.norm(extent))
    distance = max(focal * span / pixels, 1.2 * float(np.linalg.norm(extent)))
    eye = center + distance * toward_eye
    pose = look_at(eye.tolist(), center.tolist(), math.radians(rng.normal(0, 3)))
    # Turning the camera a little puts the object elsewhere in the frame. Turn less if the body would be cut off.
    reach = 0.5 - 0.6 * pixels / np.array([width, height])
    swing = rng.uniform(-1, 1, 2) * np.maximum(reach, 0) * (width, height) * 0.8 / focal
    for shrink in (1.0, 0.6, 0.3, 0.0):
        candidate = _turned(pose, float(swing[0]) * shrink, float(swing[1]) * shrink)
        if _in_frame(bounds, candidate, intrinsics):
            return Viewpoint(candidate, intrinsics)
    return Viewpoint(pose, intrinsics)


def place_clutter(
    shape: Shape, other: Shape, camera_from_world: Transform, rng: np.random.Generator, occlude: bool
) -> Shape:
    """Stand another body beside the object, or between it and the camera so that it hides a part.

    Args:
        shape: The object, in the world frame.
        other: A body standing on z = 0 about the origin, at its final size.
        camera_from_world: Pose of the camera.
        rng: Source of randomness.
        occlude: In front (within 35° of the line to the camera) rather than anywhere around.
    """
    box, other_box = shape.bounds, other.bounds
    center = box.mean(axis=1)
    eye = invert_rigid(camera_from_world)[:3, 3]
    heading = math.atan2(eye[1] - center[1], eye[0] - center[0])
    heading += math.radians(rng.uniform(-35, 35) if occlude else rng.uniform(35, 325))
    # Half diagonals of both feet keep the boxes apart whatever their yaw.
    apart = 0.5 * float(np.linalg.norm(box[:2, 1] - box[:2, 0]) + np.linalg.norm(other_box[:2, 1] - other_box[:2, 0]))
    apart *= rng.uniform(1.0, 1.5)
    offset = other_box.mean(axis=1)
    x = center[0] + apart * math.cos(heading) - offset[0]
    y = center[1] + apart * math.sin(heading) - offset[1]
    return other.moved(translation=(float(x), float(y), 0.0))


def project(points_m: Points, camera_from_world: Transform, intrinsics: Intrinsics) -> Float32[np.ndarray, "n 3"]:
    """World points to (u, v) pixels and depth z."""
    p = points_m @ camera_from_world[:3, :3].T.astype(np.float32) + camera_from_world[:3, 3].astype(np.float32)
    u = intrinsics.fx * p[:, 0] / p[:, 2] + intrinsics.cx
    v = intrinsics.fy * p[:, 1] / p[:, 2] + intrinsics.cy
    return np.stack([u, v, p[:, 2]], axis=1).astype(np.float32)


def _plane_depth(
    camera_from_world: Transform, intrinsics: Intrinsics, table_m: tuple[Number, Number, Number, Number] | None
) -> DepthImage:
    """Depth of z = 0, infinite above the horizon and off the table."""
    world_from_camera = invert_rigid(camera_from_world)
    eye_height = world_from_camera[2, 3]
    x = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx
    y = (np.arange(intrinsics.height) - intrinsics.cy) / intrinsics.fy
    r = world_from_camera[2, :3]
    falling = -((r[1] * y + r[2])[:, None] + (r[0] * x)[None, :])  # metres lost per metre of depth
    with np.errstate(divide="ignore"):
        depth = eye_height / falling
    met = (falling > 1e-9) & (eye_height > 0)
    if table_m is not None:
        for axis, (low, high) in enumerate((table_m[:2], table_m[2:])):
            r = world_from_camera[axis, :3]
            with np.errstate(invalid="ignore"):
                at = world_from_camera[axis, 3] + depth * ((r[1] * y + r[2])[:, None] + (r[0] * x)[None, :])
                met &= (at >= low) & (at <= high)
    return np.where(met, depth, np.inf).astype(np.float32)


def _corners(bounds: Bounds) -> Points:
    return np.stack(np.meshgrid(*bounds, indexing="ij"), axis=-1).reshape(-1, 3).astype(np.float32)


def _in_frame(bounds: Bounds, camera_from_world: Transform, intrinsics: Intrinsics) -> bool:
    pixels = project(_corners(bounds), camera_from_world, intrinsics)
    size = np.array([intrinsics.width, intrinsics.height])
    return bool((pixels[:, 2] > 0.05).all() and (pixels[:, :2] > 4).all() and (pixels[:, :2] < size - 5).all())


def _window(bounds: Bounds, camera_from_world: Transform, intrinsics: Intrinsics) -> tuple[slice, slice] | None:
    """Rows and columns that the box of a body projects into."""
    pixels = project(_corners(bounds), camera_from_world, intrinsics)
    if (pixels[:, 2] < 0.01).any():  # the box reaches behind the camera: its projection tells nothing
        return slice(0, intrinsics.height), slice(0, intrinsics.width)
    low = np.floor(pixels[:, :2].min(axis=0)).astype(int)
    high = np.ceil(pixels[:, :2].max(axis=0)).astype(int) + 1
    columns = slice(max(int(low[0]), 0), min(int(high[0]), intrinsics.width))
    rows = slice(max(int(low[1]), 0), min(int(high[1]), intrinsics.height))
    return None if rows.start >= rows.stop or columns.start >= columns.stop else (rows, columns)


def _turned(camera_from_world: Transform, yaw_rad: float, pitch_rad: float) -> Transform:
    """The camera turned in place about its own y and x axes."""
    cy, sy, cx, sx = math.cos(yaw_rad), math.sin(yaw_rad), math.cos(pitch_rad), math.sin(pitch_rad)
    turn = np.eye(4)
    turn[:3, :3] = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]]) @ np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    return np.asarray(turn @ camera_from_world, np.float64)
