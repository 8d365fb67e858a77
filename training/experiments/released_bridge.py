"""The bridge of the authors' release as physics knows it: a plane frame whose unknowns are found from samples.

The release names neither the load nor the clamps nor units. What its samples show is a deck on two piers, uniform
across its width, held at the feet and pressed down at one end by a dead load. Elasticity leaves few unknowns: where the
members end, how much stiffer the piers are than their thickness says, how the force leans, and how much a modulus and a
Poisson's ratio as labelled change the load number. These are found by trying, on training samples alone.

Lengths are in voxels; the centre of voxel i is at i. Axis order x, z: along the bridge and up.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64
from scipy.interpolate import CubicSpline

from training.experiments.plane_frame import PlaneFrame

KNOTS = np.linspace(-4.5, 2.25, 28)
"""Logarithms of the load numbers F l²/(E I) that are solved for, with l of ten voxels and I of the deck."""
LEVELS = np.linspace(-4.0, 2.25, 160)
"""Those whose shapes are compared with samples."""
UNIT = 10.0
DECK = (4, 13, 4)
"""Beams left of the piers, between them and right of them."""
PIER = 7
PARTS = 3
"""Quadrilaterals that a beam is drawn as."""
SWEEPS = 6
_SHRINK = 0.65
_NEAR = 4
"""Voxels that a quadrilateral may reach over, along either axis."""


class Geometry(NamedTuple):
    """Where the members end, and what thicknesses do not tell.

    Attributes:
        left: End of the deck that is free.
        right: The end that is pressed down.
        bottom: Lower side of the deck.
        top: Its upper side.
        inset: From either end to the middle of the pier.
        half_width: Half the thickness of a pier.
        foot: Where the piers are clamped.
        stiffness: Logarithm of how much stiffer piers are in bending than their thickness says.
        slant: Horizontal part of the force over its vertical part.
    """

    left: float
    right: float
    bottom: float
    top: float
    inset: float
    half_width: float
    foot: float
    stiffness: float = 0.0
    slant: float = 0.0


_STEPS = Geometry(0.25, 0.25, 0.2, 0.05, 0.3, 0.15, 0.1, 0.3, 0.1)
_BOUNDS = Geometry(1.5, 1.5, 0.7, 0.2, 2.0, 0.7, 0.6, 1.5, 0.5)
"""How far from the measured start each is looked for."""
_LOAD_STEPS = np.array([0.05, 0.1, 0.05, 0.05, 0.05, 0.05])
_LOAD_STARTS = tuple(np.array([level, np.log(20.0), 0.0, 0.3, 0.1, 0.0]) for level in (0.0, 0.7, 1.4))
"""The paper's E ends at 23 GPa and its plots start near 1; a bent plate is 1/(1 − ν²) stiffer than its beam."""

Section = Bool[np.ndarray, "n x z"]
Labels = Float32[np.ndarray, "n 2"]


@dataclass(frozen=True, eq=False)
class BridgeModel:
    """A fitted bridge.

    Attributes:
        geometry: Of the frame.
        load: Coefficients of the load number, see `terms`.
    """

    geometry: Geometry
    load: Float64[np.ndarray, "6"]

    def load_number(self, label: Labels) -> Float64[np.ndarray, " n"]:
        """Logarithm of the load number of every (Young's modulus, Poisson's ratio) as labelled."""
        number: Float64[np.ndarray, " n"] = terms(label) @ self.load
        return number

    def shapes(self, label: Labels) -> tuple[Section, Float32[np.ndarray, "n x z"]]:
        """Section of the deformed bridge, and the strain along the members at each of its voxels."""
        return shapes(self.geometry, self.load_number(label))


def terms(label: Labels) -> Float64[np.ndarray, "n 6"]:
    """What the logarithm of the load number is linear in.

    The modulus as labelled is taken to be sampled evenly in its logarithm. The powers of ν let bodies stiffen gently,
    as plates do, and steeply near the incompressible end, where finite elements lock.
    """
    stiffness, poisson = label.astype(np.float64).T
    return np.stack([np.ones(len(label)), -stiffness, -poisson, -(poisson**2), -(poisson**8), -(poisson**24)], axis=1)


def measure(rest: Bool[np.ndarray, "x z"]) -> Geometry:
    """A start for the search, from the section at rest: faces that lie on voxel centres are ties, so be generous."""
    x, z = np.nonzero(rest)
    middle = rest[(x.min() + x.max()) // 2]
    deck = np.flatnonzero(middle)
    row = rest[:, (int(z.min()) + int(deck[0])) // 2]
    pier = np.flatnonzero(row)
    breaks = np.flatnonzero(np.diff(pier) > 1)
    end = int(pier[breaks[0]]) if len(breaks) else int(pier[-1])
    left = float(x.min()) - 0.5
    return Geometry(
        left=left, right=float(x.max()) + 0.5, bottom=float(deck[0]) - 0.3, top=float(deck[-1]),
        inset=(float(pier[0]) + end) / 2 - left, half_width=(end - float(pier[0]) + 1.2) / 2, foot=float(z.min()),
    )  # fmt: skip


def frame(geometry: Geometry) -> tuple[PlaneFrame, Float64[np.ndarray, "nodes 3"]]:
    """The beams, deck first, and the forces of a load number of one."""
    g = geometry
    piers, middle = (g.left + g.inset, g.right - g.inset), (g.bottom + g.top) / 2
    ends = (g.left, *piers, g.right)
    along = [np.linspace(a, b, n + 1)[1:] for a, b, n in zip(ends, ends[1:], DECK, strict=False)]
    deck = np.concatenate([[g.left], *along])
    nodes = [np.stack([deck, np.full(len(deck), middle)], axis=1)]
    first, last = [np.arange(len(deck) - 1)], [np.arange(1, len(deck))]
    feet: list[int] = []
    up = np.linspace(g.foot, middle, PIER + 1)[:-1]
    for place, joint in zip(piers, np.cumsum(DECK), strict=False):
        foot = len(deck) + PIER * len(feet)
        chain = np.append(np.arange(foot, foot + PIER), joint)
        nodes.append(np.stack([np.full(PIER, place), up], axis=1))
        first.append(chain[:-1])
        last.append(chain[1:])
        feet.append(foot)
    thickness = half_thickness(g) * 2
    bending = (thickness / thickness[0]) ** 3 * UNIT**2
    axial = 12.0 * bending / thickness**2  # before what joints add to the bending of the piers
    bending[sum(DECK) :] *= np.exp(g.stiffness)
    places = np.concatenate(nodes)
    force = np.zeros((len(places), 3))
    force[len(deck) - 1] = g.slant, -1.0, 0.0
    return PlaneFrame(places, np.concatenate(first), np.concatenate(last), bending, axial, feet), force


def half_thickness(geometry: Geometry) -> Float64[np.ndarray, " beams"]:
    """Of every beam."""
    deck = np.full(sum(DECK), (geometry.top - geometry.bottom) / 2)
    return np.concatenate([deck, np.full(2 * PIER, geometry.half_width)])


def shapes(geometry: Geometry, level: Float64[np.ndarray, " n"]) -> tuple[Section, Float32[np.ndarray, "n x z"]]:
    """Section of the bridge and strain along its members, for logarithms of the load number."""
    beams, force = frame(geometry)
    states = beams.follow(force, np.exp(KNOTS))
    motion = CubicSpline(KNOTS, states)(np.clip(level, KNOTS[0], KNOTS[-1]))
    half = half_thickness(geometry)
    return raster(outline(beams, motion, half), outline(beams, np.zeros_like(motion[:1]), half)[0])


def outline(
    beams: PlaneFrame, motion: Float64[np.ndarray, "n nodes 3"], half: Float64[np.ndarray, " beams"]
) -> Float64[np.ndarray, "n quads 4 2"]:
    """Corners of the parts of every beam, counterclockwise, the first side that on its right.

    The axis between two nodes is Hermite's cubic, as the stiffness of a beam takes it to be.
    """
    s = np.linspace(0.0, 1.0, PARTS + 1)
    chord, ends = beams.chords(motion)
    length = np.hypot(chord[..., 0], chord[..., 1])[..., None]
    one, other = ends[..., :1], ends[..., 1:]
    aside = length * (one * (s - 2 * s**2 + s**3) + other * (s**3 - s**2))
    angle = np.arctan2(chord[..., 1], chord[..., 0])[..., None]
    leaning = angle + one * (1 - 4 * s + 3 * s**2) + other * (3 * s**2 - 2 * s)
    start = beams.nodes[beams.first] + motion[:, beams.first, :2]
    axis = start[..., None, :] + s[:, None] * chord[..., None, :] + aside[..., None] * _normal(angle)
    across = half[:, None, None] * _normal(leaning)
    right, left = axis - across, axis + across
    quads = np.stack([right[..., :-1, :], right[..., 1:, :], left[..., 1:, :], left[..., :-1, :]], axis=-2)
    return np.asarray(quads.reshape(len(motion), -1, 4, 2))


def _normal(angle: Float[np.ndarray, "*any"]) -> Float[np.ndarray, "*any 2"]:
    return np.stack([-np.sin(angle), np.cos(angle)], axis=-1)


def raster(
    quads: Float64[np.ndarray, "n quads 4 2"], rest: Float64[np.ndarray, "quads 4 2"], size: int = 64
) -> tuple[Section, Float32[np.ndarray, "n x z"]]:
    """Voxels whose centres lie in a quadrilateral, and how much this is stretched there along its first side."""
    corner = np.ceil(quads.min(axis=2)).astype(int)[:, :, None, None]
    offset = np.stack(np.meshgrid(np.arange(_NEAR), np.arange(_NEAR), indexing="ij"), axis=-1)
    voxel = corner + offset
    inside = ((voxel >= 0) & (voxel < size)).all(axis=-1)
    distance = []
    for a in range(4):
        side = (quads[:, :, (a + 1) % 4] - quads[:, :, a])[:, :, None, None]
        away = voxel - quads[:, :, a][:, :, None, None]
        signed = (side[..., 0] * away[..., 1] - side[..., 1] * away[..., 0]) / np.hypot(side[..., 0], side[..., 1])
        inside &= signed >= -1e-6
        distance.append(signed)
    stretch = [_length(quads, *side) / _length(rest, *side) - 1.0 for side in ((0, 1), (3, 2))]
    share = distance[0] / np.maximum(distance[0] + distance[2], 1e-9)
    strain = stretch[0][:, :, None, None] * (1.0 - share) + stretch[1][:, :, None, None] * share
    sample, quad, i, j = np.nonzero(inside)
    x, z = voxel[sample, quad, i, j].T
    section, strains = np.zeros((len(quads), size, size), bool), np.zeros((len(quads), size, size), np.float32)
    section[sample, x, z] = True
    strains[sample, x, z] = strain[sample, quad, i, j]
    return section, strains


def _length(quads: Float64[np.ndarray, "*n 4 2"], a: int, b: int) -> Float64[np.ndarray, "*n"]:
    side = quads[..., b, :] - quads[..., a, :]
    return np.asarray(np.hypot(side[..., 0], side[..., 1]))


def fit_bridge(label: Labels, sections: Section, rest: Bool[np.ndarray, "x z"], sweeps: int = SWEEPS) -> BridgeModel:
    """Search for the bridge whose sections overlap the samples most, one unknown after the other.

    Args:
        label: Young's modulus and Poisson's ratio of the training samples.
        sections: Their middle sections.
        rest: That of the body at rest.
        sweeps: Rounds; steps shrink from one to the next.
    """
    start = np.array(measure(rest))
    bounds, basis = np.array(_BOUNDS), terms(label)

    def overlap(geometry: Float64[np.ndarray, "9"]) -> Float32[np.ndarray, "n levels"]:
        return overlaps(shapes(Geometry(*geometry), LEVELS)[0], sections)

    table, geometry = overlap(start), start
    trials = [_fit_load(table, basis, load, _LOAD_STEPS, 3) for load in _LOAD_STARTS]
    load, best = max(trials, key=lambda trial: trial[1])
    step = np.array(_STEPS)
    for _ in range(sweeps):
        for unknown in range(len(step)):
            for sign in (1.0, -1.0):
                tried = geometry.copy()
                tried[unknown] += sign * step[unknown]
                if np.abs(tried - start)[unknown] > bounds[unknown]:
                    continue
                seen = overlap(tried)
                found, score = _fit_load(seen, basis, load, 0.3 * _LOAD_STEPS, 1)
                if score > best + 1e-6:
                    geometry, load, best, table = tried, found, score, seen
                    break
        load, best = _fit_load(table, basis, load, 0.5 * _LOAD_STEPS, 3)
        step *= _SHRINK
    return BridgeModel(Geometry(*geometry.tolist()), load)


def overlaps(shape: Bool[np.ndarray, "levels x z"], sections: Section) -> Float32[np.ndarray, "n levels"]:
    """IoU of every sample with every shape."""
    ours, theirs = (part.reshape(len(part), -1).astype(np.float32) for part in (shape, sections))
    shared = theirs @ ours.T
    return np.asarray(shared / (theirs.sum(axis=1)[:, None] + ours.sum(axis=1) - shared))


def _fit_load(
    table: Float32[np.ndarray, "n levels"], basis: Float64[np.ndarray, "n 6"], load: Float64[np.ndarray, "6"],
    step: Float64[np.ndarray, "6"], rounds: int,
) -> tuple[Float64[np.ndarray, "6"], float]:  # fmt: skip
    """Coefficients of the load number by a pattern search over the table, and the mean overlap they reach."""
    rows = np.arange(len(table))

    def score(coefficients: Float64[np.ndarray, "6"]) -> float:
        place = (basis @ coefficients - LEVELS[0]) / (LEVELS[1] - LEVELS[0])
        place = np.clip(place, 0.0, len(LEVELS) - 1.001)
        low = place.astype(int)
        share = place - low
        return float((table[rows, low] * (1.0 - share) + table[rows, low + 1] * share).mean())

    best = score(load)
    for _ in range(rounds):
        for unknown in range(len(load)):
            for sign in (1.0, -1.0):
                load, best = _climb(score, load, best, unknown, sign * step[unknown])
        step = 0.5 * step
    return load, best


def _climb(
    score: Callable[[Float64[np.ndarray, "6"]], float], load: Float64[np.ndarray, "6"], best: float, unknown: int,
    step: float,
) -> tuple[Float64[np.ndarray, "6"], float]:  # fmt: skip
    """Go on in one direction for as long as it helps."""
    while True:
        tried = load.copy()
        tried[unknown] += step
        reached = score(tried)
        if reached <= best + 1e-7:
            return load, best
        load, best = tried, reached
