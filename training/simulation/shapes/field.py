"""Signed distance fields and how they combine.

A field is negative inside and positive outside; its zero set is exact. Away from the surface the magnitude may be less
than the true distance (never more on the outside), which is what sphere tracing needs.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import reduce
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float32, Float64

Coordinate: TypeAlias = Float32[np.ndarray, " n"]
"""One coordinate of n points. Fields take x, y and z apart: contiguous columns are several times faster than rows."""
Distance: TypeAlias = Float32[np.ndarray, " n"]
Bounds: TypeAlias = Float64[np.ndarray, "axis=3 low_high=2"]
Number: TypeAlias = float | int
"""What annotations mean by float, spelt out: beartype does not take an int for a float."""
Triple: TypeAlias = tuple[Number, Number, Number]
Rotation: TypeAlias = tuple[Triple, Triple, Triple]

IDENTITY: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
UNBOUNDED = 1e6
"""Half extent that stands for "everywhere" in the bounds of a half space."""


class Field(ABC):
    """A signed distance over space, with the box that holds its body."""

    @abstractmethod
    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        """Signed distance at n points, negative inside."""

    @property
    @abstractmethod
    def bounds(self) -> Bounds:
        """A box that holds the body, not always the tightest."""

    def shift(self, x: Number = 0.0, y: Number = 0.0, z: Number = 0.0) -> Field:
        """The body moved by a vector."""
        return place(self, translation=(x, y, z))

    def turn(self, axis: Literal["x", "y", "z"], angle_rad: Number) -> Field:
        """The body turned about a coordinate axis through the origin, right-handed."""
        return place(self, rotation=axis_rotation(axis, angle_rad))

    def __or__(self, other: Field) -> Field:
        return Union((self, other))

    def __and__(self, other: Field) -> Field:
        return Intersection((self, other))

    def __sub__(self, other: Field) -> Field:
        return Subtraction(self, other)


@dataclass(frozen=True)
class Placed(Field):
    """A field under a similarity: p ↦ scale · rotation · p + translation. Build it with `place`."""

    child: Field
    rotation: Rotation
    scale: Number
    translation: Triple

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        tx, ty, tz = (np.float32(value) for value in self.translation)
        x, y, z = x - tx if tx else x, y - ty if ty else y, z - tz if tz else z
        # The inverse of the rotation is its transpose; dividing it by the scale spares one pass over the points.
        if self.rotation == IDENTITY:
            if self.scale != 1.0:
                inverse_scale = np.float32(1.0 / self.scale)
                x, y, z = x * inverse_scale, y * inverse_scale, z * inverse_scale
        else:
            m = (np.array(self.rotation).T / self.scale).astype(np.float32)
            if self.rotation[2] == IDENTITY[2]:  # a yaw: two thirds of the work
                x, y, z = m[0, 0] * x + m[0, 1] * y, m[1, 0] * x + m[1, 1] * y, m[2, 2] * z
            else:
                x, y, z = (m[i, 0] * x + m[i, 1] * y + m[i, 2] * z for i in range(3))
        distance = self.child.at(x, y, z)
        return distance if self.scale == 1.0 else distance * np.float32(self.scale)

    @property
    def bounds(self) -> Bounds:
        box = self.child.bounds
        centre, half = box.mean(axis=1), (box[:, 1] - box[:, 0]) / 2
        rotation = np.array(self.rotation)
        centre = self.scale * rotation @ centre + np.array(self.translation)
        half = self.scale * np.abs(rotation) @ half
        return np.asarray(np.stack([centre - half, centre + half], axis=1), np.float64)


@dataclass(frozen=True)
class Stretched(Field):
    """A field scaled by a different factor along each axis.

    The value is the child's times the smallest factor: a lower bound with the exact zero set, whose slope at the
    surface is below one where the body was stretched.
    """

    child: Field
    factors: Triple

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        fx, fy, fz = (np.float32(1.0 / factor) for factor in self.factors)
        return self.child.at(x * fx, y * fy, z * fz) * np.float32(min(self.factors))

    @property
    def bounds(self) -> Bounds:
        box: Bounds = self.child.bounds * np.array(self.factors)[:, None]
        return box


@dataclass(frozen=True)
class Union(Field):
    """Everything that is in any of the fields."""

    fields: tuple[Field, ...]

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        return reduce(np.minimum, (field.at(x, y, z) for field in self.fields))

    @property
    def bounds(self) -> Bounds:
        return _hull(self.fields)


@dataclass(frozen=True)
class SmoothUnion(Field):
    """A union whose seams are filled over a width.

    Source: the quadratic polynomial smooth minimum, I. Quilez, "Smooth minimum" (2013):
    min(a, b) − h²·k/4 with h = max(k − |a − b|, 0)/k.

    Attributes:
        fields: The parts, blended in order.
        width: k above, in the length unit of the fields: a seam rises by at most k/4.
    """

    fields: tuple[Field, ...]
    width: Number

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        width = np.float32(self.width)
        blended = self.fields[0].at(x, y, z)
        for field in self.fields[1:]:
            other = field.at(x, y, z)
            overlap = np.maximum(width - np.abs(blended - other), np.float32(0))
            blended = np.minimum(blended, other) - overlap * overlap * (np.float32(0.25) / width)
        return blended

    @property
    def bounds(self) -> Bounds:
        # Each blend lifts the surface by at most width/4; more than four parts never meet in one place here.
        margin = self.width / 4 * min(len(self.fields) - 1, 3)
        box: Bounds = _hull(self.fields) + np.array([-margin, margin])
        return box


@dataclass(frozen=True)
class Intersection(Field):
    """What is in all of the fields."""

    fields: tuple[Field, ...]

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        return reduce(np.maximum, (field.at(x, y, z) for field in self.fields))

    @property
    def bounds(self) -> Bounds:
        boxes = np.stack([field.bounds for field in self.fields])
        low = boxes[:, :, 0].max(axis=0)
        return np.stack([low, np.maximum(low, boxes[:, :, 1].min(axis=0))], axis=1)


@dataclass(frozen=True)
class Subtraction(Field):
    """A body less a cutter. The cutter's inside must not overstate its depth, or rays may jump thin walls."""

    body: Field
    cutter: Field

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        distance: Distance = np.maximum(self.body.at(x, y, z), -self.cutter.at(x, y, z))
        return distance

    @property
    def bounds(self) -> Bounds:
        return self.body.bounds


@dataclass(frozen=True)
class Rounded(Field):
    """A field grown by a radius, which rounds its convex edges."""

    child: Field
    radius: Number

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        return self.child.at(x, y, z) - np.float32(self.radius)

    @property
    def bounds(self) -> Bounds:
        box: Bounds = self.child.bounds + np.array([-self.radius, self.radius])
        return box


@dataclass(frozen=True)
class AboveGround(Field):
    """The half space z ≥ height: intersect with it to cut a flat foot."""

    height: Number = 0.0

    def at(self, x: Coordinate, y: Coordinate, z: Coordinate) -> Distance:
        return np.float32(self.height) - z

    @property
    def bounds(self) -> Bounds:
        return np.array([[-UNBOUNDED, UNBOUNDED], [-UNBOUNDED, UNBOUNDED], [self.height, UNBOUNDED]])


def place(
    field: Field, rotation: Rotation = IDENTITY, scale: Number = 1.0, translation: Triple = (0.0, 0.0, 0.0)
) -> Field:
    """The body under p ↦ scale · rotation · p + translation; successive placements fold into one."""
    if not isinstance(field, Placed):
        return Placed(field, rotation, scale, translation)
    outer, inner = np.array(rotation), np.array(field.rotation)
    moved = scale * outer @ np.array(field.translation) + np.array(translation)
    # Products of identities stay exactly the identity, so the fast paths of `Placed.at` survive.
    return Placed(field.child, _rotation(outer @ inner), scale * field.scale, _triple(moved))


def axis_rotation(axis: Literal["x", "y", "z"], angle_rad: Number) -> Rotation:
    """Right-handed rotation about a coordinate axis."""
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    if axis == "x":
        return ((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c))
    if axis == "y":
        return ((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c))
    return ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))


def _hull(fields: tuple[Field, ...]) -> Bounds:
    boxes = np.stack([field.bounds for field in fields])
    return np.stack([boxes[:, :, 0].min(axis=0), boxes[:, :, 1].max(axis=0)], axis=1)


def _triple(vector: np.ndarray) -> Triple:
    return (float(vector[0]), float(vector[1]), float(vector[2]))


def _rotation(matrix: np.ndarray) -> Rotation:
    return (_triple(matrix[0]), _triple(matrix[1]), _triple(matrix[2]))
