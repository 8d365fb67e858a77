"""The bodies that fields are composed from, each centred where its docstring says.

Source for the closed forms: I. Quilez, "Distance functions" (https://iquilezles.org/articles/distfunctions/); the two
convex gauges carry their own argument.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled
from training.simulation.shapes.field import Bounds, Coordinate, Distance, Field, Number, Triple

Polygon: TypeAlias = tuple[tuple[Number, Number], ...]
"""Corners of a simple closed polygon, in either turning direction; the last joins the first."""

ZERO = np.float32(0)
TINY = np.float32(1e-12)
POLYGON_BLOCK = 1024
"""Points whose distances to an edge are found together: few enough for the cache."""


@dataclass(frozen=True)
class Box(Field):
    """A box about the origin. Exact."""

    half: Triple

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        hx, hy, hz = (np.float32(value) for value in self.half)
        qx, qy, qz = np.abs(x) - hx, np.abs(y) - hy, np.abs(z) - hz
        inside = np.minimum(np.maximum(np.maximum(qx, qy), qz), ZERO)
        qx, qy, qz = np.maximum(qx, ZERO), np.maximum(qy, ZERO), np.maximum(qz, ZERO)
        distance: Distance = np.sqrt(qx * qx + qy * qy + qz * qz) + inside
        return distance

    @property
    def bounds(self) -> Bounds:
        return _symmetric(*self.half)


@dataclass(frozen=True)
class Sphere(Field):
    """A ball about the origin. Exact."""

    radius: Number

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        distance: Distance = np.sqrt(x * x + y * y + z * z) - np.float32(self.radius)
        return distance

    @property
    def bounds(self) -> Bounds:
        return _symmetric(self.radius, self.radius, self.radius)


@dataclass(frozen=True)
class Cylinder(Field):
    """An upright cylinder about the origin. Exact."""

    radius: Number
    half_height: Number

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        return _extrude(np.sqrt(x * x + y * y) - np.float32(self.radius), z, self.half_height)

    @property
    def bounds(self) -> Bounds:
        return _symmetric(self.radius, self.radius, self.half_height)


@dataclass(frozen=True)
class Torus(Field):
    """A torus about the z axis, centred on the origin. Exact."""

    major_radius: Number
    minor_radius: Number

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        q = np.sqrt(x * x + y * y) - np.float32(self.major_radius)
        distance: Distance = np.sqrt(q * q + z * z) - np.float32(self.minor_radius)
        return distance

    @property
    def bounds(self) -> Bounds:
        reach = self.major_radius + self.minor_radius
        return _symmetric(reach, reach, self.minor_radius)


@dataclass(frozen=True)
class Capsule(Field):
    """All points within `radius` of the segment from `start` to `end`. Exact."""

    start: Triple
    end: Triple
    radius: Number

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        a = np.array(self.start, np.float32)
        b = np.array(self.end, np.float32) - a
        px, py, pz = x - a[0], y - a[1], z - a[2]
        squared = np.maximum(np.dot(b, b), TINY)
        along = np.clip((px * b[0] + py * b[1] + pz * b[2]) / squared, ZERO, np.float32(1))
        px, py, pz = px - along * b[0], py - along * b[1], pz - along * b[2]
        distance: Distance = np.sqrt(px * px + py * py + pz * pz) - np.float32(self.radius)
        return distance

    @property
    def bounds(self) -> Bounds:
        ends = np.array([self.start, self.end])
        return np.stack([ends.min(axis=0) - self.radius, ends.max(axis=0) + self.radius], axis=1)


@dataclass(frozen=True)
class Ellipsoid(Field):
    """An ellipsoid about the origin.

    With the gauge g(p) = |p/a|, the value is (g − 1)/|∇g|. Outside it is a lower bound: g is convex, so the surface
    (g = 1) cannot be nearer than the drop g − 1 over the steepest slope at p. Inside it is the same to first order
    and no deeper than the smallest semi-axis; don't cut with it.
    """

    semi_axes: Triple

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        ax, ay, az = (np.float32(1 / value) for value in self.semi_axes)
        x, y, z = x * ax, y * ay, z * az
        gauge = np.sqrt(x * x + y * y + z * z)
        x, y, z = x * ax, y * ay, z * az
        slope = np.sqrt(x * x + y * y + z * z)
        distance = (gauge - np.float32(1)) * gauge / np.maximum(slope, TINY)
        return np.where(gauge > TINY, np.maximum(distance, np.float32(-min(self.semi_axes))), -min(self.semi_axes))

    @property
    def bounds(self) -> Bounds:
        return _symmetric(*self.semi_axes)


@dataclass(frozen=True)
class Superquadric(Field):
    """A superellipsoid about the origin: ((|x/a|ᵖ + |y/b|ᵖ)^(q/p) + |z/c|^q)^(1/q) ≤ 1.

    With exponents of at least 1 the left side is a norm, so (g − 1)/|∇g| bounds the distance as in `Ellipsoid`.
    Source: A. Barr, "Superquadrics and angle-preserving transformations" (1981), p = 2/ε₂, q = 2/ε₁.

    Attributes:
        semi_axes: a, b, c.
        exponent_xy: p, 1 (diamond) over 2 (ellipse) to about 8 (rounded square).
        exponent_z: q.
    """

    semi_axes: Triple
    exponent_xy: Number
    exponent_z: Number

    def __post_init__(self) -> None:
        if min(self.exponent_xy, self.exponent_z) < 1.0:
            raise ValueError(f"exponents below 1 make the body concave: {self.exponent_xy}, {self.exponent_z}")

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        ax, ay, az = (np.float32(1 / value) for value in self.semi_axes)
        p, q, one = np.float32(self.exponent_xy), np.float32(self.exponent_z), np.float32(1)
        # Ratios to the larger coordinate stay in [0, 1], so no power overflows far from the body.
        u, v, w = (np.maximum(np.abs(t), TINY) for t in (x * ax, y * ay, z * az))
        large = np.maximum(u, v)
        s = large * (one + (np.minimum(u, v) / large) ** p) ** (one / p)
        large = np.maximum(s, w)
        gauge = large * (one + (np.minimum(s, w) / large) ** q) ** (one / q)
        from_s = (s / gauge) ** (q - one)
        gx = from_s * (u / s) ** (p - one) * ax
        gy = from_s * (v / s) ** (p - one) * ay
        gz = (w / gauge) ** (q - one) * az
        distance = (gauge - one) / np.sqrt(gx * gx + gy * gy + gz * gz)
        return np.maximum(distance, np.float32(-min(self.semi_axes)))

    @property
    def bounds(self) -> Bounds:
        return _symmetric(*self.semi_axes)


@dataclass(frozen=True)
class Extrusion(Field):
    """A polygon drawn out along an axis, about the origin in that axis. Exact.

    Attributes:
        polygon: Corners in (x, y) when drawn out along z, in (x, z) when drawn out along y.
        half_length: Half of the extent along the axis.
        axis: The axis it is drawn out along.
    """

    polygon: Polygon
    half_length: Number
    axis: Literal["y", "z"] = "y"

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        across, along = (z, y) if self.axis == "y" else (y, z)
        return _extrude(polygon_distance(self.polygon, x, across), along, self.half_length)

    @property
    def bounds(self) -> Bounds:
        corners = np.array(self.polygon)
        flat = np.stack([corners.min(axis=0), corners.max(axis=0)], axis=1)
        length = np.array([-self.half_length, self.half_length])
        return np.stack([flat[0], length, flat[1]] if self.axis == "y" else [flat[0], flat[1], length])


@dataclass(frozen=True)
class Revolution(Field):
    """A polygon in (r, z), r ≥ 0, turned about the z axis. Exact. Edges that lie on the axis are no surface."""

    profile: Polygon

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        return polygon_distance(self.profile, np.sqrt(x * x + y * y), z, skip_axis=True)

    @property
    def bounds(self) -> Bounds:
        corners = np.array(self.profile)
        reach = corners[:, 0].max()
        box = _symmetric(reach, reach, 0.0)
        box[2] = corners[:, 1].min(), corners[:, 1].max()
        return box


def CappedCone(bottom_radius: Number, top_radius: Number, half_height: Number) -> Field:  # noqa: N802 (a body like the rest)
    """An upright frustum about the origin; a top radius of 0 makes a cone. Exact."""
    h = half_height
    return Revolution(((0.0, -h), (bottom_radius, -h), (top_radius, h), (0.0, h)))


def polygon_distance(
    polygon: Polygon, u: Float32[np.ndarray, " n"], v: Float32[np.ndarray, " n"], skip_axis: bool = False
) -> Float32[np.ndarray, " n"]:
    """Signed distance in the plane to a simple polygon; `skip_axis` leaves out edges along u = 0."""
    corners = np.array(polygon, np.float32)
    ends = np.roll(corners, -1, axis=0)
    kept = (corners != ends).any(axis=1)
    if skip_axis:  # no surface, and rays towards +u start at or beyond it
        kept &= (corners[:, 0] != 0) | (ends[:, 0] != 0)
    corners, edges = corners[kept], (ends - corners)[kept]
    result = np.empty(u.shape, np.float32)
    inverse_square = np.float32(1) / (edges * edges).sum(axis=1)
    _to_polygon(np.ascontiguousarray(u), np.ascontiguousarray(v), corners, edges, inverse_square, result)
    return result


@compiled
def _to_polygon(
    u: Float32[np.ndarray, " n"],
    v: Float32[np.ndarray, " n"],
    corners: Float32[np.ndarray, "m 2"],
    edges: Float32[np.ndarray, "m 2"],
    inverse_square: Float32[np.ndarray, " m"],
    result: Float32[np.ndarray, " n"],
) -> None:
    nearest, inside = np.empty(POLYGON_BLOCK, np.float32), np.empty(POLYGON_BLOCK, np.int32)
    for start in range(0, len(u), POLYGON_BLOCK):  # edge by edge for a block of points, several points at a time
        count = min(POLYGON_BLOCK, len(u) - start)
        nearest[:] = np.inf
        inside[:] = 0
        for edge in range(len(corners)):
            u0, v0, du, dv = corners[edge, 0], corners[edge, 1], edges[edge, 0], edges[edge, 1]
            share = inverse_square[edge]
            for point in range(count):
                pu, pv = u[start + point] - u0, v[start + point] - v0
                # Crossings of the ray towards +u, by the side of the edge that the point is on.
                spans = (pv >= np.float32(0)) != (pv >= dv)
                left = (pu * dv < pv * du) != (dv < np.float32(0))
                inside[point] ^= np.int32(spans & left)
                along = min(max((pu * du + pv * dv) * share, np.float32(0)), np.float32(1))
                pu -= along * du
                pv -= along * dv
                nearest[point] = min(nearest[point], pu * pu + pv * pv)
        for point in range(count):
            distance = np.sqrt(nearest[point])
            result[start + point] = -distance if inside[point] else distance


def _extrude(flat: Distance, along: Coordinate, half_length: Number) -> Distance:
    beyond = np.abs(along) - np.float32(half_length)
    inside = np.minimum(np.maximum(flat, beyond), ZERO)
    flat, beyond = np.maximum(flat, ZERO), np.maximum(beyond, ZERO)
    distance: Distance = np.sqrt(flat * flat + beyond * beyond) + inside
    return distance


def _symmetric(x: Number, y: Number, z: Number) -> Bounds:
    half = np.array([x, y, z], np.float64)
    return np.stack([-half, half], axis=1)
