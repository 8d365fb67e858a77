"""Sets of random bodies under random pushes: `everyday`, and the paper's `cylinders` and `cross-category`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from service.core.arrays import Occupancy
from service.core.condition import POISSON_RATIO_MAX
from training.data.body_cube import place_in_body_grid
from training.data.contacts import along_the_top, draw_contacts, draw_direction
from training.data.generate import Dropped
from training.data.samples import (
    LENGTHS_M,
    YOUNG_MAX_PA,
    Material,
    Response,
    Sample,
    State,
    group_of,
    respond,
    scaled,
)
from training.simulation.body import Body, BodyError
from training.simulation.families import FAMILIES, OPEN_VESSELS, sample_shape
from training.simulation.force_search import force_for_identity_iou, force_for_peak
from training.simulation.gaps import MAX_NARROW_GAPS, narrow_gaps
from training.simulation.loads import Load, LoadError
from training.simulation.newton import solve_neo_hookean
from training.simulation.overlap import RestOverlap
from training.simulation.rasterise import Rasteriser
from training.simulation.shapes import Shape, min_thickness
from training.simulation.solver import LinearSolver

YOUNG_MIN_PA = 1e4
"""Softest material drawn, a gel. Only Λ matters, so that this bounds nothing but the numbers recorded."""


@dataclass(frozen=True)
class EverydayConfig:
    """What is drawn for each body.

    Attributes:
        seed: Group i draws from SeedSequence((seed, i)), so that the set does not depend on who computes what.
        families: Names to draw from, all alike; a name that stands twice is drawn twice as often.
        cells: Cells along an edge of the simulation grid.
        vessel_cells: The same for mugs, cups and bowls, whose walls may then be thinner.
        thickness: Thinnest member that is simulated, in cells: three, less what the measurement may be off by.
        loads: Pushes on each body.
        along_top: Push at equally spaced places along the top, as the paper does, not anywhere; downwards, at any angle
            up to sideways.
        near_edge: Chance of a contact to be drawn close to an edge or rim.
        identity_iou: The largest load of each push deforms the body, by the linear law, until the IoU with itself at
            rest falls to a value drawn uniformly from this range; a fixed range of forces would make a trivial set.
            Bodies stiffen: over all samples the median is 0.73 (measured on 202; 0.70 to 0.78 is aimed at).
        peak: Range of the largest displacement under the largest load of each push, by the linear law, drawn
            log-uniformly, in units of L; None: `identity_iou` chooses.
        fractions: Load steps of the nonlinear solution, each of them a sample. None: only the linear law, one sample
            for each push.
        small_fraction: One more, linear sample at a share of the first step drawn log-uniformly from this range, so
            that a network also sees small deformations.
        small: Chance of that sample.
        patch_radius: Range of the patch radius, in edges of the grid.
        inward: Range of the mixture between a uniformly random direction (0) and straight into the surface (1).
        cone: Chance of a push into the surface, at any angle up to tangential, instead of that mixture.
        young_modulus_pa: Range of E, drawn log-uniformly.
    """

    seed: int = 0
    families: tuple[str, ...] = (*FAMILIES, *OPEN_VESSELS, *OPEN_VESSELS)
    cells: int = 24
    vessel_cells: int = 32
    thickness: float = 2.8
    loads: int = 3
    along_top: bool = False
    near_edge: float = 0.3
    identity_iou: tuple[float, float] = (0.22, 0.75)
    peak: tuple[float, float] | None = None
    fractions: tuple[float, ...] | None = (0.4, 0.7, 1.0)
    small_fraction: tuple[float, float] = (0.01, 0.5)
    small: float = 0.4
    patch_radius: tuple[float, float] = (0.08, 0.20)
    inward: tuple[float, float] = (0.0, 0.8)
    cone: float = 0.5
    young_modulus_pa: tuple[float, float] = (YOUNG_MIN_PA, YOUNG_MAX_PA)


def draw_group(config: EverydayConfig, index: int) -> dict[str, np.ndarray]:
    """One body with all its samples, as `training.data.samples.group_of` lays them out.

    Raises:
        Dropped: The draw gives no sample at all.
    """
    return _samples(config, draw_body(config, index))


def draw_samples(
    config: EverydayConfig, name: str, shape: Shape, cells: int, rng: np.random.Generator
) -> dict[str, np.ndarray]:
    """All samples of one body that stands on z = 0, wherever it comes from.

    Raises:
        Dropped: The body cannot be simulated, or none of its pushes could be solved.
    """
    return _samples(config, _body(config, name, shape, cells, rng))


@dataclass(frozen=True, eq=False)
class DrawnBody:
    """A body, its material and the pushes on it; the rest is drawn from `rng`, push by push.

    Attributes:
        name: Its family.
        shape: In the unit cube.
        thickness: Of its thinnest member, in units of L.
        material: Its material and size.
        body: On its cells.
        fine: Makes its voxels.
        overlap: Tells how a force deforms it.
        pushes: Of unit strength.
        rng: After all that.
    """

    name: str
    shape: Shape
    thickness: float
    material: Material
    body: Body
    fine: Rasteriser
    overlap: RestOverlap
    pushes: list[Push]
    rng: np.random.Generator


class ChosenLoad(NamedTuple):
    """A push at the force chosen for it, the linear response to one of unit strength, and the share of a small sample.

    Attributes:
        load: At its largest.
        response: To the push of unit strength.
        small: Part of the first step at which there is one more, linear sample; None: there is none.
    """

    load: Load
    response: Response
    small: float | None


def draw_body(config: EverydayConfig, index: int) -> DrawnBody:
    """The body of a group and the pushes on it.

    Raises:
        Dropped: The body cannot be simulated.
    """
    rng = np.random.default_rng(np.random.SeedSequence((config.seed, index)))
    family = config.families[rng.integers(len(config.families))]
    cells = config.vessel_cells if family in OPEN_VESSELS else config.cells
    try:
        shape = sample_shape(family, rng, cells=cells)
    except RuntimeError as error:  # no body of the family stood in as many tries as it is given
        raise Dropped("no_shape") from error
    return _body(config, family, shape, cells, rng)


def draw_load(config: EverydayConfig, drawn: DrawnBody, solver: LinearSolver, push: Push) -> ChosenLoad | None:
    """The force of a push, by the overlap or the peak drawn for it; None where there is none.

    Call it for one push after the other.

    Raises:
        LoadError: The push touches no material.
    """
    rng = drawn.rng
    target = float(rng.uniform(*config.identity_iou))
    small = float(np.exp(rng.uniform(*np.log(config.small_fraction)))) if rng.random() < config.small else None
    (response,) = respond(solver, [push.unit])
    if config.peak is not None:
        peak = float(np.exp(rng.uniform(*np.log(config.peak))))
        load = force_for_peak(drawn.body, push.unit, response.displacement, peak)
    else:
        load = force_for_identity_iou(drawn.overlap, push.unit, response.displacement, target)
    return None if load is None else ChosenLoad(load, response, small)


def _body(config: EverydayConfig, name: str, shape: Shape, cells: int, rng: np.random.Generator) -> DrawnBody:
    cube = place_in_body_grid(shape)
    thickness = float(min_thickness(cube.shape))
    if thickness < config.thickness / cells:
        raise Dropped("thin")
    material = Material(
        young_modulus_pa=float(np.exp(rng.uniform(*np.log(config.young_modulus_pa)))),
        poisson_ratio=float(rng.uniform(0.0, POISSON_RATIO_MAX)),
        edge_m=float(np.exp(rng.uniform(*np.log(LENGTHS_M)))),
    )
    try:
        body = Body.from_distance(cube.shape.distance, cells)
        if narrow_gaps(body) > MAX_NARROW_GAPS:
            raise Dropped("narrow_gap")
        fine, overlap = Rasteriser(body), RestOverlap.of(body)
        pushes = draw_pushes(config, body, fine.rest, rng)
    except BodyError as error:
        raise Dropped(error.reason) from error
    return DrawnBody(name, cube.shape, thickness, material, body, fine, overlap, pushes, rng)


def _samples(config: EverydayConfig, drawn: DrawnBody) -> dict[str, np.ndarray]:
    solver = LinearSolver(drawn.body, drawn.material.poisson_ratio)
    samples: list[Sample] = []
    for number, push in enumerate(drawn.pushes):
        try:
            chosen = draw_load(config, drawn, solver, push)
        except LoadError:
            continue
        if chosen is None:
            continue
        load, response, small = chosen
        steps = config.fractions
        fractions = (1.0,) if steps is None else (steps[0] * small,) if small is not None else ()
        state = State(drawn.fine, drawn.material, number, push.location)
        samples += [state.linear(scaled(load, part), response, part) for part in fractions]
        forces = load.load_number * response.forces
        for step in solve_neo_hookean(solver, load, steps, forces=forces) if steps is not None else ():
            if step.converged:
                samples.append(state.nonlinear(solver, step))
    if not samples:
        raise Dropped("no_solution")
    return group_of(drawn.name, drawn.fine.rest, drawn.material.edge_m, samples)


class Push(NamedTuple):
    """A load of unit strength, and where along the top it is (`Sample.of`)."""

    unit: Load
    location: tuple[int, float]


def draw_pushes(config: EverydayConfig, body: Body, rest: Occupancy, rng: np.random.Generator) -> list[Push]:
    """Places, directions and patches of all pushes on a body.

    Raises:
        BodyError: The surface could not be sampled.
    """
    if config.along_top:
        radius = float(np.mean(config.patch_radius))
        up = np.array([0.0, 0.0, 1.0])
        places = along_the_top(body, rest, config.loads)
        share = np.linspace(0.0, 1.0, config.loads)
        return [
            Push(Load(place, draw_direction(up, config.inward, 1.0, rng), 1.0, radius), (i, float(share[i])))
            for i, place in enumerate(places)
        ]
    contacts, normals = draw_contacts(body, config.loads, config.near_edge, rng)
    return [
        Push(
            Load(
                contact, draw_direction(normal, config.inward, config.cone, rng), 1.0,
                float(rng.uniform(*config.patch_radius)),
            ),
            (-1, np.nan),
        )
        for contact, normal in zip(contacts, normals, strict=True)
    ]  # fmt: skip
