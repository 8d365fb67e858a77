"""Families of plain solids: boxes, cylinders, cones, tori, superquadrics and what random operations make of them."""

from __future__ import annotations

import math

import numpy as np

from training.simulation.shapes.field import Field, Number, Rounded, SmoothUnion, Stretched, Union
from training.simulation.shapes.primitives import (
    Box,
    CappedCone,
    Capsule,
    Cylinder,
    Ellipsoid,
    Extrusion,
    Sphere,
    Superquadric,
    Torus,
)
from training.simulation.shapes.shape import FILL_HEIGHT, FILL_HORIZONTAL, Shape, stand

Rng = np.random.Generator

SIMULABLE = 0.14
"""Least thickness of a member as a part of the body grid's edge: three cells of 1/24, and a little to spare."""


def grid_edge(*extents: Number) -> float:
    """L for a body of width, depth (both horizontal) and height, in that order."""
    width, depth, height = extents
    return max(width / FILL_HORIZONTAL, depth / FILL_HORIZONTAL, height / FILL_HEIGHT)


def extents(rng: Rng, thin: bool, slimmest: float = 0.2, tallest: float = 3.0) -> tuple[float, float, float]:
    """Width 1, depth 0.35 to 1, height log-uniform in `slimmest` to `tallest` widths; thick enough unless `thin`."""
    while True:
        width = 1.0
        depth = rng.uniform(0.12 if thin else 0.35, 1.0)
        height = math.exp(rng.uniform(math.log(slimmest * (0.4 if thin else 1.0)), math.log(tallest)))
        if thin or min(depth, height) >= SIMULABLE * grid_edge(width, depth, height):
            return width, depth, height


def member(rng: Rng, thin: bool, edge: Number, thickest: float = 0.26) -> float:
    """Thickness of a limb, leg or plate of a body whose grid edge is `edge`."""
    return edge * (rng.uniform(0.03, SIMULABLE) if thin else rng.uniform(SIMULABLE, thickest))


def box(rng: Rng, thin: bool) -> Shape:
    width, depth, height = extents(rng, thin)
    return stand("box", Box((width / 2, depth / 2, height / 2)))


def rounded_box(rng: Rng, thin: bool) -> Shape:
    half = np.array(extents(rng, thin)) / 2
    radius = rng.uniform(0.15, 0.6) * half.min()
    core = half - radius
    return stand("rounded_box", Rounded(Box((core[0], core[1], core[2])), radius), cut=0.02)


def cylinder(rng: Rng, thin: bool) -> Shape:
    width, depth, height = extents(rng, thin)
    upright = Cylinder(width / 2, height / 2)
    # Half of them oval; the other half exactly round.
    return stand("cylinder", Stretched(upright, (1.0, max(depth, 0.5), 1.0)) if rng.random() < 0.5 else upright)


def cone(rng: Rng, thin: bool) -> Shape:
    height = rng.uniform(0.4, 2.2)
    # A sharp tip is thinner than any cell, so simulable cones are cut short.
    top = rng.uniform(0.02, 0.4) if thin else max(rng.uniform(0.3, 0.8), SIMULABLE * grid_edge(1, 1, height))
    return stand("cone", CappedCone(0.5, min(top, 0.9) / 2, height / 2))


def prism(rng: Rng, thin: bool) -> Shape:
    """Three to eight sides, standing on its end or lying on a side."""
    sides = int(rng.integers(3, 9))
    angles = 2 * math.pi * (np.arange(sides) + 0.5) / sides - math.pi / 2
    corners = tuple((0.5 * math.cos(a), 0.5 * math.sin(a)) for a in angles)
    if rng.random() < 0.5:
        height = rng.uniform(0.25, 2.2)
        return stand("prism", Extrusion(corners, height / 2, axis="z"))
    return stand("prism", Extrusion(corners, rng.uniform(0.3, 1.4) / 2))


def torus(rng: Rng, thin: bool) -> Shape:
    minor = rng.uniform(0.1, 0.2) if thin else rng.uniform(0.24, 0.35)
    return stand("torus", Torus(1.0 - minor, minor), cut=rng.uniform(0.08, 0.2))


def ring(rng: Rng, thin: bool) -> Shape:
    """A torus on its rim, with a flat foot."""
    minor = rng.uniform(0.08, 0.2) if thin else rng.uniform(0.26, 0.38)
    return stand("ring", Torus(1.0 - minor, minor).turn("x", math.pi / 2), cut=rng.uniform(0.05, 0.1))


def capsule(rng: Rng, thin: bool) -> Shape:
    """Lying on its side, or a ball when short."""
    half_length = rng.uniform(0.1, 0.8 if thin else 0.6)
    radius = rng.uniform(0.08, 0.3) if thin else rng.uniform(0.2, 0.4)
    return stand("capsule", Capsule((-half_length, 0, 0), (half_length, 0, 0), radius), cut=rng.uniform(0.05, 0.12))


def superquadric(rng: Rng, thin: bool) -> Shape:
    width, depth, height = extents(rng, thin, tallest=2.5)
    p, q = np.exp(rng.uniform(math.log(1.5), math.log(7.0), 2))
    body = Superquadric((width / 2, depth / 2, height / 2), float(p), float(q))
    return stand("superquadric", body, cut=rng.uniform(0.06, 0.2))


def blob(rng: Rng, thin: bool) -> Shape:
    """Balls grown together."""
    count = int(rng.integers(3, 7))
    parts: list[Field] = []
    centre = np.zeros(3)
    for _ in range(count):
        radius = rng.uniform(0.2, 0.45)
        parts.append(Sphere(radius).shift(*(float(c) for c in centre)))
        step = rng.normal(size=3) * np.array([1.0, 1.0, 0.8])
        centre = centre + step / np.linalg.norm(step) * rng.uniform(0.9, 1.5) * radius
    return stand("blob", SmoothUnion(tuple(parts), rng.uniform(0.1, 0.3)), cut=rng.uniform(0.1, 0.25))


def csg(rng: Rng, thin: bool) -> Shape:
    """Two or three primitives joined, then one or two cut away."""
    body = _random_primitive(rng, 0.3, 0.6)
    for _ in range(int(rng.integers(1, 3))):
        body = body | _random_primitive(rng, 0.25, 0.5).shift(*rng.uniform(-0.45, 0.45, 3))
    for _ in range(int(rng.integers(1, 3))):
        direction = rng.normal(size=3)
        direction *= rng.uniform(0.5, 0.7) / np.linalg.norm(direction)
        body = body - _random_primitive(rng, 0.15, 0.3).shift(*direction)
    return stand("csg", body, cut=rng.uniform(0.05, 0.15))


def _random_primitive(rng: Rng, low: float, high: float) -> Field:
    """One of the primitives that are exact on both sides, in a random orientation."""
    a, b, c = (float(value) for value in rng.uniform(low, high, 3))
    kind = rng.integers(4)
    body: Field = (Box((a, b, c)), Cylinder(a, b), Sphere(a), Capsule((-b / 2, 0, 0), (b / 2, 0, 0), a * 0.7))[kind]
    if rng.random() < 0.5:
        body = body.turn("x", rng.uniform(0, math.pi)).turn("z", rng.uniform(0, math.pi))
    return body


def fruit(rng: Rng, thin: bool) -> Shape:
    """Apple, pear, egg or potato: one or two ellipsoids grown together."""
    lower = Ellipsoid((0.5, rng.uniform(0.4, 0.5), rng.uniform(0.38, 0.55)))
    if rng.random() < 0.4:
        return stand("fruit", lower, cut=rng.uniform(0.06, 0.15))
    radius = rng.uniform(0.22, 0.36)
    upper = Ellipsoid((radius, radius, radius * rng.uniform(0.9, 1.5)))
    offset = (rng.uniform(-0.1, 0.1), rng.uniform(-0.1, 0.1), rng.uniform(0.25, 0.55))
    body = SmoothUnion((lower, upper.shift(*offset)), rng.uniform(0.2, 0.5))
    return stand("fruit", body, cut=rng.uniform(0.06, 0.15))


def crescent(rng: Rng, thin: bool) -> Shape:
    """A banana: a chain of capsules along an arc, lying."""
    arc = rng.uniform(1.4, 2.8)
    radius = rng.uniform(0.09, 0.15) if thin else rng.uniform(0.3, 0.38)
    angles = np.linspace(-arc / 2, arc / 2, 7)
    points = [(math.sin(a), -math.cos(a), 0.0) for a in angles]
    sizes = radius * (1 - rng.uniform(0.0, 0.35 if thin else 0.15) * (angles / angles[-1]) ** 2)
    parts = tuple(
        Capsule(points[i], points[i + 1], float((sizes[i] + sizes[i + 1]) / 2)) for i in range(len(points) - 1)
    )
    return stand("crescent", Union(parts), cut=rng.uniform(0.08, 0.15))


def dumbbell(rng: Rng, thin: bool) -> Shape:
    """Two weights on a bar."""
    bar = rng.uniform(0.08, 0.15) if thin else rng.uniform(0.2, 0.28)
    ball = bar * rng.uniform(1.3, 2.2)
    half = rng.uniform(0.4, 0.6)
    weights: list[Field]
    if rng.random() < 0.5:
        weights = [Sphere(ball).shift(x=side * half) for side in (-1, 1)]
    else:
        length = rng.uniform(0.12, 0.25)
        weights = [Cylinder(ball, length).turn("y", math.pi / 2).shift(x=side * half) for side in (-1, 1)]
    grip = Capsule((-half, 0, 0), (half, 0, 0), bar)
    return stand("dumbbell", SmoothUnion((*weights, grip), 0.05), cut=rng.uniform(0.05, 0.12))
