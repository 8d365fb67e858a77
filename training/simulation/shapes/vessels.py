"""Families turned on a lathe: mugs, bottles, bowls, cans, vases, tubes. Walls are thin, or thick enough to simulate."""

from __future__ import annotations

import math

import numpy as np

from training.simulation.shapes.field import Field, Number, Rounded, SmoothUnion, Union
from training.simulation.shapes.primitives import Box, Capsule, Cylinder, Ellipsoid, Revolution, Torus
from training.simulation.shapes.shape import Shape, stand
from training.simulation.shapes.solids import SIMULABLE, Rng, grid_edge

PROFILE_POINTS = 9
"""Corners of a curved profile; each costs one edge distance at every point."""


def wall(rng: Rng, thin: bool, edge: Number, cells: int = 24) -> float:
    """Wall of a hollow vessel: 2 to 4 % of the grid edge, or three to four cells to simulate, and a little to spare."""
    return edge * (rng.uniform(0.02, 0.04) if thin else rng.uniform(SIMULABLE, 0.17) * 24 / cells)


def _hollow(outer: np.ndarray, thickness: float, floor: float) -> Revolution:
    """A vessel from its outer profile, rows (r, z) from the foot up, with walls of about constant thickness."""
    inner = outer.copy()
    slope = np.gradient(outer[:, 0], outer[:, 1])
    inner[:, 0] -= thickness * np.sqrt(1 + slope**2)
    inner = inner[(inner[:, 0] > 0.02) & (inner[:, 1] > outer[0, 1] + floor)]
    bottom = np.interp(outer[0, 1] + floor, outer[:, 1], outer[:, 0])
    bottom_slope = np.interp(outer[0, 1] + floor, outer[:, 1], slope)
    inner_bottom = max(float(bottom - thickness * math.sqrt(1 + bottom_slope**2)), 0.02)
    top_of_floor = outer[0, 1] + floor
    corners = [(0.0, outer[0, 1]), *outer, *inner[::-1], (inner_bottom, top_of_floor), (0.0, top_of_floor)]
    return Revolution(tuple((float(r), float(z)) for r, z in corners))


def _mug_body(rng: Rng, thin: bool, height: float, cells: int) -> tuple[Revolution, float]:
    thickness = wall(rng, thin, grid_edge(1.3 if thin else 1.6, 1, height), cells)
    foot, lip = rng.uniform(0.36, 0.5), 0.5
    bulge = rng.uniform(-0.03, 0.06) if rng.random() < 0.5 else 0.0
    t = np.linspace(0, 1, 5 if bulge else 2)
    outer = np.stack([foot + (lip - foot) * t + bulge * np.sin(math.pi * t), t * height], axis=1)
    return _hollow(outer, thickness, thickness), thickness


def mug(rng: Rng, thin: bool, cells: int = 24) -> Shape:
    """Hollow, with a handle."""
    height = rng.uniform(0.75 if thin else 1.0, 1.4)
    body, thickness = _mug_body(rng, thin, height, cells)
    grip = rng.uniform(0.05, 0.08) if thin else thickness * rng.uniform(0.5, 0.6)
    rise = min(rng.uniform(0.24, 0.34) * height, 0.4, 0.46 * height - grip)
    reach = rng.uniform(0.5, 0.55)
    loop = Torus(rise, grip).turn("x", math.pi / 2).shift(x=reach, z=rng.uniform(0.48, 0.56) * height)
    # Only what lies outside the vessel's outer surface: a handle has no business in the coffee.
    handle = loop - Cylinder(0.47, height)
    return stand("mug", Union((body, handle)))


def cup(rng: Rng, thin: bool, cells: int = 24) -> Shape:
    """Hollow, no handle: a tumbler, a paper cup, a flower pot."""
    height = rng.uniform(0.6, 1.6)
    thickness = wall(rng, thin, grid_edge(1, 1, height), cells)
    foot = rng.uniform(0.32, 0.5)
    outer = np.array([(foot, 0.0), (0.5, height)])
    return stand("cup", _hollow(outer, thickness, thickness * rng.uniform(1.0, 1.4)))


def bowl(rng: Rng, thin: bool, cells: int = 24) -> Shape:
    """Hollow, round below."""
    height = rng.uniform(0.3, 0.55)
    thickness = wall(rng, thin, grid_edge(1, 1, height), cells)
    foot = rng.uniform(0.16, 0.26)
    t = np.linspace(0, 1, PROFILE_POINTS)
    # A quarter of a superellipse from the foot to the lip: larger exponents give steeper walls.
    power = rng.uniform(1.6, 3.0)
    radius = foot + (0.5 - foot) * (1 - (1 - t) ** power) ** (1 / power)
    return stand("bowl", _hollow(np.stack([radius, t**1.5 * height], axis=1), thickness, thickness))


def can(rng: Rng, thin: bool) -> Shape:
    """A closed can with a rim, top and bottom a little recessed."""
    height = rng.uniform(0.35, 2.2)
    rim, recess = rng.uniform(0.02, 0.04), rng.uniform(0.01, 0.04)
    bevel = rng.uniform(0.0, 0.08)
    profile = (
        (0.0, 0.0), (0.5 - bevel, 0.0), (0.5, bevel), (0.5, height - bevel), (0.5 - bevel, height),
        (0.5 - bevel - rim, height), (0.5 - bevel - rim, height - recess), (0.0, height - recess),
    )  # fmt: skip
    return stand("can", Revolution(profile))


def bottle(rng: Rng, thin: bool) -> Shape:
    """Closed: body, shoulder, neck and cap."""
    height = rng.uniform(1.4, 3.0)
    edge = grid_edge(1, 1, height)
    neck = rng.uniform(0.1, 0.2) if thin else min(max(rng.uniform(0.14, 0.26), 0.54 * SIMULABLE * edge), 0.34)
    shoulder = height * rng.uniform(0.5, 0.75)
    shoulder_length = rng.uniform(0.15, 0.4)
    neck_base = min(shoulder + shoulder_length, height * 0.9)
    t = np.linspace(0, 1, 6)
    radius = neck + (0.5 - neck) * (0.5 + 0.5 * np.cos(math.pi * t))
    curve = np.stack([radius, shoulder + (neck_base - shoulder) * t], axis=1)
    waist = rng.uniform(0.85, 1.0) if rng.random() < 0.4 else 1.0
    lower = [(0.0, 0.0), (0.46, 0.0), (0.5, 0.05), (0.5 * waist, shoulder * 0.5)]
    cap = neck * rng.uniform(1.0, 1.25)
    upper = [(neck, height * 0.93), (cap, height * 0.93), (cap, height), (0.0, height)]
    profile = [*lower, *((float(r), float(z)) for r, z in curve)]
    profile += [corner for corner in upper if corner[1] >= neck_base]
    body: Field = Revolution(tuple(profile))
    if rng.random() < 0.3:  # flattened, as shampoo bottles are
        depth = rng.uniform(0.5, 0.65) if thin else rng.uniform(0.65, 0.8)
        core = Box((0.5 - 0.15, depth / 2 - 0.15, shoulder / 2 - 0.15))
        lid = Cylinder(cap, (height - shoulder) / 2 + 0.1).shift(z=(height + shoulder) / 2 - 0.1)
        body = SmoothUnion((Rounded(core, 0.15).shift(z=shoulder / 2), lid), 0.15)
    return stand("bottle", body, cut=0.005)


def vase(rng: Rng, thin: bool) -> Shape:
    """A smooth random profile: solid to simulate, hollow otherwise."""
    height = rng.uniform(0.9, 2.2)
    knots = rng.uniform(0.28, 0.5, 4)
    knots[rng.integers(0, 3)] = 0.5
    t = np.linspace(0, 1, PROFILE_POINTS)
    # Smooth interpolation between knots: half-cosine steps.
    place = np.minimum(t * 3, 2.999)
    left = place.astype(int)
    blend = 0.5 - 0.5 * np.cos(math.pi * (place - left))
    radius = knots[left] * (1 - blend) + knots[left + 1] * blend
    outer = np.stack([radius, t * height], axis=1)
    if thin:
        thickness = wall(rng, True, grid_edge(1, 1, height))
        return stand("vase", _hollow(outer, thickness, thickness))
    corners = [(0.0, 0.0), *((float(r), float(z)) for r, z in outer), (0.0, height)]
    return stand("vase", Revolution(tuple(corners)))


def tube(rng: Rng, thin: bool) -> Shape:
    """A pipe, standing or lying; a roll of tape when short."""
    height = rng.uniform(0.3, 1.8)
    thickness = wall(rng, thin, grid_edge(1, 1, height))
    inner = max(0.5 - thickness * (rng.uniform(1, 3) if thin else 1.0), 0.08)
    body = Revolution(((inner, 0.0), (0.5, 0.0), (0.5, height), (inner, height)))
    if rng.random() < 0.6:
        return stand("tube", body)
    return stand("tube", body.turn("y", math.pi / 2), cut=min(0.04, 0.3 * thickness))


def jug(rng: Rng, thin: bool) -> Shape:
    """A closed jug or kettle: a bulbous body, a spout and a handle."""
    body = Ellipsoid((0.5, 0.5, rng.uniform(0.42, 0.7)))
    limb = rng.uniform(0.05, 0.09) if thin else rng.uniform(0.19, 0.22)
    spout = Capsule((0.3, 0, 0.0), (rng.uniform(0.62, 0.75), 0, rng.uniform(0.25, 0.45)), limb)
    handle = Torus(rng.uniform(0.28, 0.34), limb).turn("x", math.pi / 2).shift(x=-0.5, z=0.05)
    lid = Cylinder(rng.uniform(0.2, 0.28), 0.08).shift(z=body.semi_axes[2])
    return stand("jug", SmoothUnion((body, lid, spout, handle), 0.08), cut=rng.uniform(0.12, 0.25))


def mushroom(rng: Rng, thin: bool) -> Shape:
    """A cap on a stem with a foot: mushroom, desk lamp, goblet upside down."""
    height = rng.uniform(0.7, 1.5)
    edge = grid_edge(1, 1, height)
    stem = rng.uniform(0.03, 0.1) if thin else rng.uniform(0.55, 0.9) * SIMULABLE * edge
    cap_height = rng.uniform(0.26, 0.5) * height
    # Solid caps have a rim: a sharp edge would be thinner than any cell.
    low, rim = height - cap_height, 0.0 if thin else 0.6 * cap_height
    foot = max(rng.uniform(0.2, 0.42), stem * 1.1)
    foot_height = rng.uniform(0.04, 0.1) * height if thin else SIMULABLE * edge
    parts: tuple[Field, ...] = (
        Cylinder(foot, foot_height / 2).shift(z=foot_height / 2),
        Cylinder(stem, height / 2 - cap_height / 4).shift(z=height / 2 - cap_height / 4),
        Revolution(((0, low), (0.5, low), (0.5, low + rim), (rng.uniform(0.15, 0.4), height), (0, height))),
    )
    return stand("mushroom", SmoothUnion(parts, rng.uniform(0.02, 0.1)))
