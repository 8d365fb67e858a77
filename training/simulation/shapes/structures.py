"""Families built from straight members: profiles of the paper (bridge, L, T, U), furniture, towers and stairs."""

from __future__ import annotations

import math

import numpy as np

from training.simulation.shapes.field import Field, Number, Union
from training.simulation.shapes.primitives import Box, Cylinder, Extrusion, Polygon
from training.simulation.shapes.shape import Shape, stand
from training.simulation.shapes.solids import SIMULABLE, Rng, grid_edge, member

Interval = tuple[Number, Number]


def block(x: Interval, y: Interval, z: Interval) -> Field:
    """The box from the first to the second value on each axis."""
    centre = [(low + high) / 2 for low, high in (x, y, z)]
    half = [(high - low) / 2 for low, high in (x, y, z)]
    return Box((half[0], half[1], half[2])).shift(*centre)


def _profile(rng: Rng, thin: bool, shortest: float, tallest: float) -> tuple[float, float, float]:
    """Height, depth and grid edge of a profile of width 1."""
    height = rng.uniform(shortest, tallest)
    edge = grid_edge(1, 1, height)
    depth = rng.uniform(0.15 if thin else SIMULABLE * edge, 1.0)
    return height, depth, edge


def bridge(rng: Rng, thin: bool) -> Shape:
    """The paper's bridge: a deck on two piers."""
    height, depth, edge = _profile(rng, thin, 0.4, 1.2)
    deck, left, right = min(member(rng, thin, edge), height / 2), member(rng, thin, edge), member(rng, thin, edge)
    outline = (
        (0, 0), (left, 0), (left, height - deck), (1 - right, height - deck),
        (1 - right, 0), (1, 0), (1, height), (0, height),
    )  # fmt: skip
    return stand("bridge", Extrusion(outline, depth / 2))


def arch(rng: Rng, thin: bool) -> Shape:
    """A block with a round opening."""
    height, depth, edge = _profile(rng, thin, 0.55, 1.2)
    wall = member(rng, thin, edge, 0.22)
    radius = 0.5 - wall
    rise = min(height - member(rng, thin, edge, 0.22), height * 0.85)
    # A flat opening where there is no room for the full half circle.
    opening: Field = Cylinder(radius, 1).turn("x", math.pi / 2).shift(z=max(rise - radius, 0.0))
    if rise > radius:
        opening = opening | block((-radius, radius), (-1, 1), (-1, rise - radius))
    else:
        opening = opening & block((-1, 1), (-1, 1), (-1, rise))
    return stand("arch", block((-0.5, 0.5), (-depth / 2, depth / 2), (0, height)) - opening)


def table(rng: Rng, thin: bool) -> Shape:
    """A top, rectangular or round, on four legs or three."""
    height = rng.uniform(0.4, 1.3)
    edge = grid_edge(1, 1, height)
    depth = rng.uniform(0.55, 1.0)
    top, leg = min(member(rng, thin, edge, 0.2), 0.5 * height), member(rng, thin, edge, 0.19)
    is_round = rng.random() < 0.35
    if is_round:
        depth = 1.0
        board: Field = Cylinder(0.5, top / 2).shift(z=height - top / 2)
        count = int(rng.integers(3, 5))
        reach = 0.5 - leg * rng.uniform(0.5, 0.8)
        feet = [(reach * math.cos(a), reach * math.sin(a)) for a in 2 * math.pi * (np.arange(count) + 0.5) / count]
    else:
        board = block((-0.5, 0.5), (-depth / 2, depth / 2), (height - top, height))
        inset = leg / 2 + rng.uniform(0, 0.05)
        feet = [(sx * (0.5 - inset), sy * (depth / 2 - inset)) for sx in (-1, 1) for sy in (-1, 1)]
    post: Field = Cylinder(leg / 2, height / 2) if rng.random() < 0.5 else Box((leg / 2, leg / 2, height / 2))
    return stand("table", Union((board, *(post.shift(x, y, height / 2) for x, y in feet))))


def chair(rng: Rng, thin: bool) -> Shape:
    """A seat, a back, and four legs, side panels or a solid base."""
    seat_height, back_height = rng.uniform(0.4, 0.8), rng.uniform(0.4, 0.9)
    height = seat_height + back_height
    edge = grid_edge(1, 1, height)
    depth = rng.uniform(0.75, 1.0)
    seat, back, leg = (min(member(rng, thin, edge, 0.2), 0.45) for _ in range(3))
    parts = [
        block((-0.5, 0.5), (0, depth), (seat_height - seat, seat_height)),
        block((-0.5, 0.5), (depth - back, depth), (seat_height - seat, height)),
    ]
    style = rng.random()
    if style < 0.6:
        for x in (-0.5, 0.5 - leg):
            for y in (0.0, depth - leg):
                parts.append(block((x, x + leg), (y, y + leg), (0, seat_height - seat / 2)))
    elif style < 0.8:
        parts += [block((x, x + leg), (0, depth), (0, seat_height - seat / 2)) for x in (-0.5, 0.5 - leg)]
    else:
        parts.append(block((-0.5, 0.5), (0, depth), (0, seat_height - seat / 2)))
    if rng.random() < 0.3:  # armrests
        arm = seat_height + 0.45 * back_height
        parts += [block((x, x + leg), (0, depth), (seat_height - seat / 2, arm)) for x in (-0.5, 0.5 - leg)]
    return stand("chair", Union(tuple(parts)))


def letter_l(rng: Rng, thin: bool) -> Shape:
    height, depth, edge = _profile(rng, thin, 0.5, 1.8)
    foot, post = min(member(rng, thin, edge), 0.6 * height), min(member(rng, thin, edge, 0.34), 0.7)
    outline = ((0, 0), (1, 0), (1, foot), (post, foot), (post, height), (0, height))
    return stand("L", Extrusion(outline, depth / 2))


def letter_t(rng: Rng, thin: bool) -> Shape:
    """On its stem or upside down."""
    height, depth, edge = _profile(rng, thin, 0.5, 1.5)
    bar, stem = min(member(rng, thin, edge), 0.6 * height), min(member(rng, thin, edge, 0.34), 0.7)
    side = (1 - stem) / 2 + (rng.uniform(-0.15, 0.15) if rng.random() < 0.5 else 0.0)
    side = float(np.clip(side, 0.02, 0.98 - stem))
    outline = np.array(
        [(0, 0), (1, 0), (1, bar), (side + stem, bar), (side + stem, height), (side, height), (side, bar), (0, bar)]
    )
    if rng.random() < 0.5:
        outline[:, 1] = height - outline[:, 1]
    return stand("T", Extrusion(_polygon(outline), depth / 2))


def letter_u(rng: Rng, thin: bool) -> Shape:
    height, depth, edge = _profile(rng, thin, 0.4, 1.4)
    base, left, right = min(member(rng, thin, edge), 0.6 * height), member(rng, thin, edge), member(rng, thin, edge)
    other = height * rng.uniform(0.6, 1.0)
    other = max(other, base * 1.2)
    outline = (
        (0, 0), (1, 0), (1, other), (1 - right, other), (1 - right, base), (left, base), (left, height), (0, height)
    )  # fmt: skip
    return stand("U", Extrusion(outline, depth / 2))


def h_beam(rng: Rng, thin: bool) -> Shape:
    """Two flanges and a web, as an I or as an H."""
    height, depth, edge = _profile(rng, thin, 0.6, 1.5)
    upright = rng.random() < 0.5
    across, along = (1.0, height) if upright else (height, 1.0)
    flange = min(member(rng, thin, edge, 0.2), along * 0.4)
    web = min(member(rng, thin, edge), across * 0.6)
    s = (across - web) / 2
    outline = np.array(
        [
            (0, 0), (across, 0), (across, flange), (s + web, flange), (s + web, along - flange),
            (across, along - flange), (across, along), (0, along),
            (0, along - flange), (s, along - flange), (s, flange), (0, flange),
        ]
    )  # fmt: skip
    return stand("h_beam", Extrusion(_polygon(outline if upright else outline[:, ::-1]), depth / 2))


def stairs(rng: Rng, thin: bool) -> Shape:
    steps = int(rng.integers(2, 5))
    height, depth, _ = _profile(rng, thin, 0.5, 1.2)
    outline = [(1.0, 0.0), (1.0, height)]
    for i in range(steps, 0, -1):
        outline += [((i - 1) / steps, height * i / steps), ((i - 1) / steps, height * (i - 1) / steps)]
    return stand("stairs", Extrusion(_polygon(np.array(outline)), depth / 2))


def tower(rng: Rng, thin: bool) -> Shape:
    """Two to four boxes and cylinders on top of each other, a little askew."""
    count = int(rng.integers(2, 5))
    parts: list[Field] = []
    base = 0.0
    size = 1.0
    x, y = 0.0, 0.0
    for _ in range(count):
        height = rng.uniform(0.25, 0.7)
        half = size / 2
        # Each part reaches a hair into the one below: two faces that only touch are not one body.
        if rng.random() < 0.5:
            part: Field = Box((half, half * rng.uniform(0.7, 1.0), height / 2 + 0.005))
            part = part.turn("z", rng.uniform(0, math.pi))
        else:
            part = Cylinder(half, height / 2 + 0.005)
        parts.append(part.shift(x, y, base + height / 2))
        base += height
        smaller = size * rng.uniform(0.6, 1.05)
        slack = 0.2 * smaller
        x, y = x + rng.uniform(-slack, slack), y + rng.uniform(-slack, slack)
        size = smaller
    return stand("tower", Union(tuple(parts)))


def carton(rng: Rng, thin: bool) -> Shape:
    """A milk carton or a house: a box with a gable."""
    height = rng.uniform(0.6, 2.2)
    depth = rng.uniform(0.6, 1.3)
    roof = rng.uniform(0.2, 0.5)
    ridge = rng.uniform(0.02, 0.1) if thin else rng.uniform(0.3, 0.5)
    top = height + roof
    outline = ((-0.5, 0), (0.5, 0), (0.5, height), (ridge / 2, top), (-ridge / 2, top), (-0.5, height))
    return stand("carton", Extrusion(outline, depth / 2))


def _polygon(corners: np.ndarray) -> Polygon:
    return tuple((float(u), float(v)) for u, v in corners)
