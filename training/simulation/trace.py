"""Sphere tracing: where the rays of an image meet a body.

Source: J. Hart, "Sphere tracing" (1996). Blocks of pixels are first marched as cones, then each pixel as a cone of half
a pixel; secant steps land on the surface, and the few rays that graze it are sampled pixel by pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32

from service.core.arrays import Transform
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


@dataclass(frozen=True)
class Rays:
    """Rays from one eye, points eye + depth·direction, where a direction advances 1 along the optical axis."""

    eye: Float32[np.ndarray, "3"]
    x: Float32[np.ndarray, " n"]
    y: Float32[np.ndarray, " n"]
    z: Float32[np.ndarray, " n"]

    @property
    def length(self) -> Float32[np.ndarray, " n"]:
        """Metres per metre of depth."""
        length: Float32[np.ndarray, " n"] = np.sqrt(self.x * self.x + self.y * self.y + self.z * self.z)
        return length

    def take(self, index: np.ndarray) -> Rays:
        return replace(self, x=self.x[index], y=self.y[index], z=self.z[index])

    def repeated(self, times: int) -> Rays:
        return replace(self, x=self.x.repeat(times), y=self.y.repeat(times), z=self.z.repeat(times))


def pixel_rays(camera_from_world: Transform, intrinsics: Intrinsics, u: np.ndarray, v: np.ndarray) -> Rays:
    world_from_camera = invert_rigid(camera_from_world)
    a, b = (u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy
    r = world_from_camera[:3, :3]
    x, y, z = ((r[i, 0] * a + r[i, 1] * b + r[i, 2]).astype(np.float32) for i in range(3))
    return Rays(world_from_camera[:3, 3].astype(np.float32), x, y, z)


def _box_span(rays: Rays, bounds: Bounds) -> tuple[Float32[np.ndarray, " n"], Float32[np.ndarray, " n"]]:
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


def trace(
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
    block_v = rows.start + np.arange(block_rows) * COARSE + middle
    block_u = columns.start + np.arange(block_columns) * COARSE + middle
    v, u = np.meshgrid(block_v, block_u, indexing="ij")
    rays = pixel_rays(camera_from_world, intrinsics, u.ravel(), v.ravel())
    # Radius of the cone per unit depth: half the diagonal of the block, pixel centre to pixel centre.
    spread = np.float32(math.sqrt(2) * middle / min(intrinsics.fx, intrinsics.fy))
    near, far = _box_span(rays, box + spread * _reach(box, rays.eye) * np.array([-1.0, 1.0]))
    start = _march(body, rays, near, far, spread).reshape(block_rows, block_columns)

    starts = np.repeat(np.repeat(start, COARSE, axis=0), COARSE, axis=1)[:height, :width].ravel()
    v, u = np.meshgrid(np.arange(rows.start, rows.stop), np.arange(columns.start, columns.stop), indexing="ij")
    chosen = np.flatnonzero(np.isfinite(starts))
    rays = pixel_rays(camera_from_world, intrinsics, u.ravel()[chosen], v.ravel()[chosen])
    near, far = _box_span(rays, box)
    far = np.minimum(far, behind.ravel()[chosen])
    footprint = np.float32(0.5 / min(intrinsics.fx, intrinsics.fy))
    close = _march(body, rays, np.maximum(near, starts[chosen]), far, footprint)
    depth = np.full(height * width, np.inf, np.float32)
    depth[chosen] = _land(body, rays, close, far, tolerance, footprint)
    return depth.reshape(height, width)


def _reach(bounds: Bounds, eye: Float32[np.ndarray, "3"]) -> float:
    """Distance from the eye to the farthest corner of a box."""
    return float(np.linalg.norm(np.maximum(np.abs(bounds[:, 0] - eye), np.abs(bounds[:, 1] - eye))))


def _march(
    body: Shape,
    rays: Rays,
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
    rays: Rays,
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
    rays: Rays,
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
    rays: Rays,
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


def _along(body: Shape, rays: Rays, depth: Float32[np.ndarray, " n"]) -> Float32[np.ndarray, " n"]:
    """Signed distance at one depth along each ray."""
    return body.field.at(rays.eye[0] + depth * rays.x, rays.eye[1] + depth * rays.y, rays.eye[2] + depth * rays.z)
