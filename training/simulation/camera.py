"""A depth camera: sphere tracing of bodies on a support plane.

Pixel (u, v) looks along ((u − cx)/fx, (v − cy)/fy, 1) in the optical frame (x right, y down, z forward); depth is the
z of the first surface met. Bodies live in the world frame, metres, z up, support plane z = 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32

from service.core.arrays import DepthImage, Mask, Points, Transform
from service.core.camera import Intrinsics
from service.core.grids import invert_rigid
from training.simulation.shapes import Bounds, Shape

HIT = 1e-5
"""A ray has arrived when it is this part of the body's size from the surface: 4 µm on a mug of 40 cm."""
MARCH_STEPS = 30
"""Steps that a cone or a ray takes by itself; what is still under way is handed on to the next, slower stage."""
FEW = 64
"""A march also ends when no more than this many are under way: a step costs a few hundred calls whatever it moves."""
SECANT_STEPS = 4
"""A surface is nearly flat over a pixel, so the secant method lands on it in two or three steps."""
SCAN_SAMPLES = 16
SCAN_ROUNDS = 100
"""Rays that graze a body are sampled this many pixels at a time. 100 rounds would cross the widest image twice."""
COARSE = 4
"""Block of pixels marched as one cone before each pixel gets its own ray."""
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
    farthest_m: float = FARTHEST_M,
) -> Rendering:
    """Depth image of a body on its support.

    Args:
        shape: The object, in the world frame.
        camera_from_world: Rigid transform.
        intrinsics: Of the camera.
        plane: Whether the support plane z = 0 is there.
        clutter: Other bodies in the scene; the mask leaves out what they hide.
        farthest_m: Range of the camera along z.
    """
    size = (intrinsics.height, intrinsics.width)
    depth = _plane_depth(camera_from_world, intrinsics) if plane else np.full(size, np.inf, np.float32)
    mask = np.zeros(size, bool)
    for body in (*clutter, shape):
        window = _window(body.bounds, camera_from_world, intrinsics)
        if window is None:
            continue
        rows, columns = window
        behind = depth[rows, columns]
        found = _trace(body, camera_from_world, intrinsics, rows, columns, behind)
        nearer = found < behind
        behind[nearer] = found[nearer]
        mask[rows, columns] = nearer if body is shape else mask[rows, columns] & ~nearer
    depth[~(depth <= farthest_m)] = np.nan
    return Rendering(depth, mask & np.isfinite(depth))


def look_at(eye_m: Sequence[float], target_m: Sequence[float], roll_rad: float = 0.0) -> Transform:
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


def sample_viewpoint(bounds: Bounds, rng: np.random.Generator, width: int = 640, height: int = 480) -> Viewpoint:
    """A camera somewhere around a body, as a robot's would be.

    Elevation 5° to 75°, mostly 15° to 60°; any azimuth; a roll of a few degrees; fx ≈ fy in 500 to 920 for a width of
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
    elevation = math.radians(rng.uniform(15, 60) if narrow else rng.uniform(5, 75))
    azimuth = rng.uniform(0, 2 * math.pi)
    toward_eye = np.array(
        [math.cos(elevation) * math.cos(azimuth), math.cos(elevation) * math.sin(azimuth), math.sin(elevation)]
    )
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


def _plane_depth(camera_from_world: Transform, intrinsics: Intrinsics) -> DepthImage:
    """Depth of z = 0, infinite above the horizon."""
    world_from_camera = invert_rigid(camera_from_world)
    eye_height = world_from_camera[2, 3]
    x = (np.arange(intrinsics.width) - intrinsics.cx) / intrinsics.fx
    y = (np.arange(intrinsics.height) - intrinsics.cy) / intrinsics.fy
    r = world_from_camera[2, :3]
    falling = -((r[1] * y + r[2])[:, None] + (r[0] * x)[None, :])  # metres lost per metre of depth
    with np.errstate(divide="ignore"):
        depth = eye_height / falling
    return np.where((falling > 1e-9) & (eye_height > 0), depth, np.inf).astype(np.float32)


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
    return turn @ camera_from_world


@dataclass(frozen=True)
class _Rays:
    """Rays from one eye, points eye + depth·direction, where a direction advances 1 along the optical axis."""

    eye: Float32[np.ndarray, "3"]
    x: Float32[np.ndarray, " n"]
    y: Float32[np.ndarray, " n"]
    z: Float32[np.ndarray, " n"]

    @property
    def length(self) -> Float32[np.ndarray, " n"]:
        """Metres per metre of depth."""
        return np.sqrt(self.x * self.x + self.y * self.y + self.z * self.z)

    def take(self, index: np.ndarray) -> _Rays:
        return replace(self, x=self.x[index], y=self.y[index], z=self.z[index])

    def repeated(self, times: int) -> _Rays:
        return replace(self, x=self.x.repeat(times), y=self.y.repeat(times), z=self.z.repeat(times))


def _rays(camera_from_world: Transform, intrinsics: Intrinsics, u: np.ndarray, v: np.ndarray) -> _Rays:
    world_from_camera = invert_rigid(camera_from_world)
    a, b = (u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy
    r = world_from_camera[:3, :3]
    x, y, z = ((r[i, 0] * a + r[i, 1] * b + r[i, 2]).astype(np.float32) for i in range(3))
    return _Rays(world_from_camera[:3, 3].astype(np.float32), x, y, z)


def _box_span(rays: _Rays, bounds: Bounds) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
    """Depths at which rays enter and leave a box (slab method); entry beyond exit means a miss."""
    near = np.zeros(rays.x.shape, np.float32)
    far = np.full(rays.x.shape, np.inf, np.float32)
    for axis, direction in enumerate((rays.x, rays.y, rays.z)):
        inverse = np.float32(1) / np.where(np.abs(direction) < 1e-9, np.float32(1e-9), direction)
        first = (np.float32(bounds[axis, 0]) - rays.eye[axis]) * inverse
        second = (np.float32(bounds[axis, 1]) - rays.eye[axis]) * inverse
        near = np.maximum(near, np.minimum(first, second))
        far = np.minimum(far, np.maximum(first, second))
    return near, far


def _trace(
    body: Shape,
    camera_from_world: Transform,
    intrinsics: Intrinsics,
    rows: slice,
    columns: slice,
    behind: Float32[np.ndarray, "h w"],
) -> Float32[np.ndarray, "h w"]:
    """Depth of the body over a window of the image, infinite where it is not met before `behind`.

    Blocks of pixels go first as one cone each, until the surface may lie inside the cone; pixels start from there.
    Source: Hart, "Sphere tracing" (1996), with cone marching for the start.
    """
    height, width = rows.stop - rows.start, columns.stop - columns.start
    box = body.bounds
    margin = 1e-3 * (box[:, 1] - box[:, 0]).max()
    box = box + np.array([-margin, margin])
    tolerance = np.float32(HIT * (box[:, 1] - box[:, 0]).max())

    block_rows, block_columns = -(-height // COARSE), -(-width // COARSE)
    middle = (COARSE - 1) / 2
    v, u = np.meshgrid(
        rows.start + np.arange(block_rows) * COARSE + middle, columns.start + np.arange(block_columns) * COARSE + middle,
        indexing="ij",
    )  # fmt: skip
    rays = _rays(camera_from_world, intrinsics, u.ravel(), v.ravel())
    # Radius of the cone per unit depth: half the diagonal of the block, pixel centre to pixel centre.
    spread = np.float32(math.sqrt(2) * middle / min(intrinsics.fx, intrinsics.fy))
    near, far = _box_span(rays, box + spread * _reach(box, rays.eye) * np.array([-1.0, 1.0]))
    start = _march(body, rays, near, far, spread).reshape(block_rows, block_columns)

    start = np.repeat(np.repeat(start, COARSE, axis=0), COARSE, axis=1)[:height, :width].ravel()
    v, u = np.meshgrid(np.arange(rows.start, rows.stop), np.arange(columns.start, columns.stop), indexing="ij")
    chosen = np.flatnonzero(np.isfinite(start))
    rays = _rays(camera_from_world, intrinsics, u.ravel()[chosen], v.ravel()[chosen])
    near, far = _box_span(rays, box)
    far = np.minimum(far, behind.ravel()[chosen])
    footprint = np.float32(0.5 / min(intrinsics.fx, intrinsics.fy))
    close = _march(body, rays, np.maximum(near, start[chosen]), far, footprint)
    depth = np.full(height * width, np.inf, np.float32)
    depth[chosen] = _land(body, rays, close, far, tolerance, footprint)
    return depth.reshape(height, width)


def _reach(bounds: Bounds, eye: Float32[np.ndarray, "3"]) -> float:
    """Distance from the eye to the farthest corner of a box."""
    return float(np.linalg.norm(np.maximum(np.abs(bounds[:, 0] - eye), np.abs(bounds[:, 1] - eye))))


def _march(
    body: Shape,
    rays: _Rays,
    near: Float32[np.ndarray, " n"],
    far: Float32[np.ndarray, " n"],
    spread: np.float32,
) -> Float32[np.ndarray, " n"]:
    """Depth to which a cone of radius spread·depth is surely clear of the body; infinite if it leaves the scene."""
    result = np.full(near.shape, np.inf, np.float32)
    active = np.flatnonzero(near < far)
    rays = rays.take(active)
    depth, far = near[active], far[active]
    length = rays.length
    for _ in range(MARCH_STEPS):
        if len(active) <= FEW:
            break
        distance = _along(body, rays, depth)
        # Stop a little early: the last stretch would take many small steps.
        arrived = distance <= np.float32(1.3) * spread * depth
        result[active[arrived]] = depth[arrived]
        # The rim moves sideways by `spread` while the axis moves by `length`; the empty ball holds both.
        depth = depth + (distance - spread * depth) / (length + spread)
        going = ~arrived & (depth < far)
        active, depth, far, length = active[going], depth[going], far[going], length[going]
        rays = rays.take(going)
    result[active] = depth
    return result


def _land(
    body: Shape,
    rays: _Rays,
    close: Float32[np.ndarray, " n"],
    far: Float32[np.ndarray, " n"],
    tolerance: np.float32,
    footprint: np.float32,
) -> Float32[np.ndarray, " n"]:
    """Exact depths of rays that have come within about a pixel of a surface; infinite where they miss it."""
    result = np.full(close.shape, np.inf, np.float32)
    chosen = np.flatnonzero(np.isfinite(close))
    under_way, part = chosen, rays.take(chosen)
    first = close[chosen]
    first_distance = _along(body, part, first)
    second = first + first_distance / part.length
    for _ in range(SECANT_STEPS):
        second_distance = _along(body, part, second)
        landed = np.abs(second_distance) <= tolerance
        result[under_way[landed]] = second[landed]
        off = ~landed
        under_way, part, first, first_distance = under_way[off], part.take(off), first[off], first_distance[off]
        second, second_distance = second[off], second_distance[off]
        change = second_distance - first_distance
        step = -second_distance * (second - first) / np.where(change == 0, np.float32(1e-12), change)
        longest = np.float32(12) * footprint * second
        first, first_distance, second = second, second_distance, second + np.clip(step, -longest, longest)
    # A root behind the start belongs to the far side of what the ray only grazed.
    lost = ~(np.isfinite(result) & (result >= close))
    result[lost | (result >= far)] = np.inf
    # What is left are rays past an edge at less than a pixel, grazing ones, and those that meet a crease.
    rest = np.flatnonzero(lost & np.isfinite(close))
    result[rest] = _scan(body, rays.take(rest), close[rest], far[rest], np.float32(2) * footprint)
    return result


def _scan(
    body: Shape,
    rays: _Rays,
    near: Float32[np.ndarray, " n"],
    far: Float32[np.ndarray, " n"],
    pixel: np.float32,
) -> Float32[np.ndarray, " n"]:
    """Depth at which each ray first enters the body, found by samples one pixel apart and regula falsi between two."""
    result = np.full(near.shape, np.inf, np.float32)
    active = np.flatnonzero(near < far)
    depth = near[active]
    steps = np.arange(SCAN_SAMPLES, dtype=np.float32)
    for _ in range(SCAN_ROUNDS):
        if not len(active):
            break
        part = rays.take(active)
        samples = depth[:, None] * (1 + pixel * steps)
        distance = _along(body, part.repeated(SCAN_SAMPLES), samples.ravel()).reshape(samples.shape)
        inside = distance <= 0
        entry = np.where(inside.any(axis=1), inside.argmax(axis=1), -1)
        met = np.flatnonzero(entry >= 0)
        at, before = entry[met], np.maximum(entry[met] - 1, 0)
        result[active[met]] = _bracketed(
            body, part.take(met), samples[met, before], samples[met, at], distance[met, before], distance[met, at]
        )
        depth = samples[:, -1] + np.maximum(distance[:, -1] / part.length, pixel * samples[:, -1])
        going = (entry < 0) & (depth < far[active])
        active, depth = active[going], depth[going]
    result[result >= far] = np.inf
    return result


def _bracketed(
    body: Shape,
    rays: _Rays,
    outside: Float32[np.ndarray, " n"],
    inside: Float32[np.ndarray, " n"],
    above: Float32[np.ndarray, " n"],
    below: Float32[np.ndarray, " n"],
) -> Float32[np.ndarray, " n"]:
    """Root between a depth outside the body and one inside, by regula falsi with the Illinois rule."""
    for _ in range(2 * SECANT_STEPS):
        depth = outside + (inside - outside) * above / np.maximum(above - below, np.float32(1e-12))
        distance = _along(body, rays, depth)
        out = distance > 0
        # Halving the value at the end that stays keeps the bracket from closing from one side only.
        above, below = np.where(out, distance, above / 2), np.where(out, below / 2, distance)
        outside, inside = np.where(out, depth, outside), np.where(out, inside, depth)
    return np.asarray(outside + (inside - outside) * above / np.maximum(above - below, np.float32(1e-12)), np.float32)


def _along(body: Shape, rays: _Rays, depth: Float32[np.ndarray, " n"]) -> Float32[np.ndarray, " n"]:
    """Signed distance at one depth along each ray."""
    return body.field.at(rays.eye[0] + depth * rays.x, rays.eye[1] + depth * rays.y, rays.eye[2] + depth * rays.z)
