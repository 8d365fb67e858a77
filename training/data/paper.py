"""The paper's sets of one body under a grid of materials, forces, places or stretches, by the linear law.

Wang et al., "3D-PhysNet" (IJCAI 2018), sections 3.5, 4.1 and 4.3. What it leaves open is settled here: the bridge has
the proportions of the one in the authors' released data, in metres; moduli span two decades below the paper's 23 GPa,
over which the released samples go from an overlap of 0.40 to 0.93 with the body at rest.
"""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from training.data.body_cube import BodyCube, place_in_body_grid
from training.data.contacts import along_the_top
from training.data.generate import Dropped
from training.data.samples import YOUNG_MAX_PA, Material, Response, State, group_of, respond
from training.simulation.body import Body, BodyError
from training.simulation.loads import Load
from training.simulation.rasterise import Rasteriser
from training.simulation.shapes import Shape, stand
from training.simulation.shapes.structures import block
from training.simulation.solver import LinearSolver

BRIDGE_M = (1.0, 0.43, 0.43)
"""Length, width and height; the released bridge has 42 × 18 × 18 voxels."""
MEMBER_M = 0.14
"""Thickness of deck and piers, of which the released bridge has 0.07: three cells of our grid instead of one."""
OVERHANG = 1 / 6
"""Part of the length that the deck reaches beyond each pier, as in the released data."""

FOLD = 7919
"""A prime: group i holds the grid's entry i · FOLD mod n, so that any first few groups, and any split of them by
number, are spread over the whole grid."""


@dataclass(frozen=True)
class PaperConfig:
    """A grid of values; the set holds every combination.

    Attributes:
        young_modulus_pa: Range of E and how many values, log-spaced.
        poisson_ratio: Range of ν and how many values, evenly spaced.
        force_n: Largest force and how many, evenly spaced from the largest down to above zero.
        locations: Places along the top, pushed downwards; 0: the middle of the deck's end, pushed along the deck.
        scales: Range of the stretch along each axis and how many values, evenly spaced; all combinations.
        cells: Cells along an edge of the simulation grid.
        patch_m: Radius of the loaded patch.
    """

    young_modulus_pa: tuple[float, float, int] = (0.05 * YOUNG_MAX_PA, YOUNG_MAX_PA, 1)
    poisson_ratio: tuple[float, float, int] = (0.3, 0.3, 1)
    force_n: tuple[float, int] = (1.0, 1)
    locations: int = 0
    scales: tuple[float, float, int] = (1.0, 1.0, 1)
    cells: int = 32
    patch_m: float = 0.14

    @property
    def count(self) -> int:
        """Combinations."""
        return math.prod(self._sizes)

    @property
    def _sizes(self) -> tuple[int, ...]:
        scales = (self.scales[2],) * 3
        return self.young_modulus_pa[2], self.poisson_ratio[2], self.force_n[1], max(self.locations, 1), *scales

    def entry(self, index: int) -> Entry:
        """The combination of group `index`."""
        place = np.unravel_index(index * FOLD % self.count, self._sizes)
        e, nu, force, location, *stretch = (int(i) for i in place)
        young = np.geomspace(*self.young_modulus_pa)
        scales = np.linspace(*self.scales)
        return Entry(
            float(young[e]),
            float(np.linspace(*self.poisson_ratio)[nu]),
            self.force_n[0] * (1.0 - force / self.force_n[1]),
            location,
            (float(scales[stretch[0]]), float(scales[stretch[1]]), float(scales[stretch[2]])),
        )


class Entry(NamedTuple):
    """One combination of a grid."""

    young_modulus_pa: float
    poisson_ratio: float
    force_n: float
    location: int
    stretch: tuple[float, float, float]


def bridge(stretch: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Shape:
    """A deck on two walls, in metres, stretched along x, y and z: of scaled parts, whose distances are exact."""
    (length, width, height), (deep, _, high) = _stretched_sizes(stretch)
    half, reach = width / 2, length * (0.5 - OVERHANG)
    deck = block((-length / 2, length / 2), (-half, half), (height - high, height))
    left = block((-reach, deep - reach), (-half, half), (0.0, height - high / 2))
    right = block((reach - deep, reach), (-half, half), (0.0, height - high / 2))
    return stand("bridge", deck | left | right)


def _stretched_sizes(stretch: tuple[float, float, float]) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Length, width and height of the whole, and of a member."""
    return (
        tuple(size * scale for size, scale in zip(BRIDGE_M, stretch, strict=True)),
        tuple(MEMBER_M * scale for scale in stretch),
    )


def draw_group(config: PaperConfig, index: int) -> dict[str, np.ndarray]:
    """One entry of the grid: a group of one sample, so that splits by group are splits over the grid.

    Raises:
        Dropped: The body cannot be simulated.
    """
    entry = config.entry(index)
    stretched = _stretched(entry.stretch, config.cells)
    units, responses = _responses(config, entry.stretch, entry.poisson_ratio)
    unit = units[entry.location]
    cube = stretched.cube
    material = Material(entry.young_modulus_pa, entry.poisson_ratio, cube.edge)
    load_number = entry.force_n / (entry.young_modulus_pa * cube.edge**2)
    load = Load(unit.contact, unit.direction, load_number, unit.patch_radius)
    share = entry.location / max(config.locations - 1, 1)
    state = State(stretched.rasteriser, material, 0, (entry.location if config.locations else -1, share))
    sample = state.linear(load, responses[entry.location], entry.force_n / config.force_n[0])
    return group_of("bridge", stretched.rasteriser.rest, cube.edge, [sample])


class _Stretched(NamedTuple):
    cube: BodyCube
    body: Body
    rasteriser: Rasteriser


# A process draws many groups of one body: what they share is computed once. Sizes bound the memory of a worker.
@functools.lru_cache(maxsize=2)
def _stretched(stretch: tuple[float, float, float], cells: int) -> _Stretched:
    cube = place_in_body_grid(bridge(stretch))
    try:
        body = Body.from_distance(cube.shape.distance, cells)
    except BodyError as error:
        raise Dropped(error.reason) from error
    return _Stretched(cube, body, Rasteriser(body))


@functools.lru_cache(maxsize=24)
def _responses(
    config: PaperConfig, stretch: tuple[float, float, float], poisson_ratio: float
) -> tuple[list[Load], list[Response]]:
    """Loads of unit strength at all places, and the displacements under them: right-hand sides of one factor."""
    cube, body, rasteriser = _stretched(stretch, config.cells)
    radius = config.patch_m / cube.edge
    if config.locations:
        try:
            places = along_the_top(body, rasteriser.rest, config.locations)
        except BodyError as error:
            raise Dropped(error.reason) from error
        units = [Load(place, np.array([0.0, 0.0, -1.0]), 1.0, radius) for place in places]
    else:
        (length, _, height), (_, _, high) = _stretched_sizes(stretch)
        end = cube.point((-length / 2, 0.0, height - high / 2))
        units = [Load(end, cube.vector((1.0, 0.0, 0.0)), 1.0, radius)]
    return units, respond(LinearSolver(body, poisson_ratio), units)
