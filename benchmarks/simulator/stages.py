"""What a sample goes through, stage by stage, under a stopwatch."""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from service.core.grids import pack_bits
from training.data.body_cube import place_in_body_grid
from training.data.everyday import EverydayConfig
from training.data.fields import block_means, coarsen, extend
from training.data.store import Store
from training.simulation import solver as solver_module
from training.simulation.body import Body, BodyError
from training.simulation.enhanced import EnhancedHexahedron
from training.simulation.families import FAMILIES, sample_shape
from training.simulation.force_search import force_for_identity_iou
from training.simulation.loads import Load, load_cases
from training.simulation.mean_dilatation import MeanDilatationHexahedron
from training.simulation.newton import solve_neo_hookean
from training.simulation.overlap import RestOverlap
from training.simulation.rasterise import Rasteriser
from training.simulation.sampled import SampledDistance
from training.simulation.shapes import min_thickness
from training.simulation.stress import linear_von_mises, von_mises

ELEMENTS = {"mean-dilatation": MeanDilatationHexahedron, "enhanced": EnhancedHexahedron}
A_BODY = ("fill", "number", "contacts", "rest", "skin", "assembly", "factor")
"""Stages that all samples of a body share."""
A_SAMPLE = ("load", "solve", "force search", "voxelise", "stress")
"""Stages of every finished linear sample."""
BESIDE = ("draw", "pack", "store")
"""Stages that a sample is finished without."""
FRACTIONS = (1 / 3, 2 / 3, 1.0)


@dataclass
class Stopwatch:
    """Wall and processor seconds by stage."""

    wall_s: dict[str, float] = field(default_factory=dict)
    cpu_s: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def __call__(self, stage: str) -> Iterator[None]:
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            yield
        finally:
            self.wall_s[stage] = self.wall_s.get(stage, 0.0) + time.perf_counter() - wall
            self.cpu_s[stage] = self.cpu_s.get(stage, 0.0) + time.process_time() - cpu


@dataclass
class Counts:
    """What was finished, and the processor time of Newton's method for loads that do not reach their full force."""

    bodies: int = 0
    linear: int = 0
    nonlinear: int = 0
    dropped: int = 0
    failed_s: float = 0.0
    cells: list[int] = field(default_factory=list)


def drawn_body(rng: np.random.Generator, cells: int, watch: Stopwatch) -> Body | None:
    """A body of the default families; None where the draw is one that data sets leave out."""
    with watch("draw"):
        try:
            shape = place_in_body_grid(sample_shape(FAMILIES[rng.integers(len(FAMILIES))], rng)).shape
        except RuntimeError:
            return None
        if min_thickness(shape) < EverydayConfig().thickness / cells:
            return None
    try:
        with watch("fill"):
            sampled = SampledDistance.of(shape.distance, cells)
            fill = sampled.octant_fill
        with watch("number"):
            return Body.from_fill(sampled, fill)
    except BodyError:
        return None


def linear_samples(body: Body, count: int, rng: np.random.Generator, make: Callable[[Body], Any], watch: Stopwatch,
                   counts: Counts) -> list[dict[str, np.ndarray]]:  # fmt: skip
    """Finish `count` loads of one body; returns what a data set would keep of them."""
    with watch("contacts"):
        contacts, normals = body.surface_points(count, rng)
    with watch("rest"):
        fine, overlap = Rasteriser(body), RestOverlap.of(body)
    with watch("skin"):
        _ = body.skin
    with watch("assembly"):  # the factor's time is taken out below
        solver = make(body)
    loads = [
        Load(contact, -normal / np.linalg.norm(normal), 1.0, float(rng.uniform(0.08, 0.20)))
        for contact, normal in zip(contacts, normals, strict=True)
    ]
    with watch("load"):
        forces = load_cases(body, loads)
    with watch("solve"):
        displacements = solver.solve_forces(forces)
    rows = []
    for load, displacement in zip(loads, displacements, strict=True):
        with watch("force search"):
            found = force_for_identity_iou(overlap, load, displacement, float(rng.uniform(0.30, 0.85)))
        if found is None:
            counts.dropped += 1
            continue
        with watch("voxelise"):
            result = fine(found.load_number * displacement)
        with watch("stress"):
            stress = fine.at_rest(linear_von_mises(solver, found.load_number * displacement))
        counts.linear += 1
        with watch("pack"):
            columns = {"deformed": pack_bits(result.deformed)}
            share = block_means(result.at_rest, stress)
            columns["von_mises"] = (share / share.max()).astype(np.float16)
            fields = {
                "displacement": (result.deformed_at, result.moved_here),
                "forward": (result.at_rest, result.moved_from),
            }
            for name, (index, values) in fields.items():
                coarse, covered = coarsen(index, values)
                wide, known = extend(coarse, covered > 0)
                columns[name] = wide[:, known].astype(np.float16)
            rows.append(columns)
    counts.bodies += 1
    counts.cells.append(len(body.active))
    return rows


@contextmanager
def factor_timed(watch: Stopwatch) -> Iterator[None]:
    """Book the factorisation inside `LinearSolver` as a stage of its own."""
    original = solver_module.factorise

    def timed(*arguments: Any) -> Any:
        with watch("factor"):
            return original(*arguments)

    solver_module.factorise = timed
    try:
        yield
    finally:
        solver_module.factorise = original


def measure_linear(args: argparse.Namespace) -> tuple[Stopwatch, Counts, list[Body]]:
    """Stages of linear samples of `--bodies` bodies with `--loads` loads each."""
    watch, counts, bodies = Stopwatch(), Counts(), []
    element = ELEMENTS[args.element]
    with tempfile.TemporaryDirectory() as folder, factor_timed(watch):
        store = Store(Path(folder))
        for seed in range(1000):
            rng = np.random.default_rng(np.random.SeedSequence((args.seed, seed)))
            body = drawn_body(rng, args.cells, watch)
            if body is None:
                continue
            poisson_ratio = float(rng.uniform(0.0, 0.49))
            rows = linear_samples(
                body, args.loads, rng, lambda b, nu=poisson_ratio: solver_module.LinearSolver(b, nu, element),
                watch, counts,
            )  # fmt: skip
            with watch("store"):
                arrays = {f"{key}{i}": value for i, row in enumerate(rows) for key, value in row.items()}
                store.write_group(seed, arrays)
            bodies.append(body)
            if len(bodies) == args.bodies:
                break
    for seconds in (watch.wall_s, watch.cpu_s):
        seconds["assembly"] -= seconds["factor"]
    return watch, counts, bodies


def measure_nonlinear(args: argparse.Namespace, bodies: list[Body]) -> tuple[Stopwatch, Counts]:
    """Three load steps for each of three loads of a body, as the default data set takes them."""
    watch, counts = Stopwatch(), Counts()
    for number, body in enumerate(bodies):
        rng = np.random.default_rng(np.random.SeedSequence((args.seed, 7, number)))
        body.__dict__.pop("pattern", None)  # computed once for a body: to be paid here too
        with watch("body"):
            body = Body.from_distance(body.distance.distance, args.cells)
            contacts, normals = body.surface_points(args.nonlinear_loads, rng)
            fine, overlap = Rasteriser(body), RestOverlap.of(body)
            solver = solver_module.LinearSolver(body, float(rng.uniform(0.0, 0.49)), ELEMENTS[args.element])
        for contact, normal in zip(contacts, normals, strict=True):
            load = Load(contact, -normal, 1.0, float(rng.uniform(0.08, 0.20)))
            with watch("linear"):
                forces = load_cases(body, [load])
                displacement = solver.solve_forces(forces)[0]
                found = force_for_identity_iou(overlap, load, displacement, float(rng.uniform(0.30, 0.85)))
            if found is None:
                continue
            before = watch.cpu_s.get("newton", 0.0)
            with watch("newton"):
                steps = solve_neo_hookean(solver, found, FRACTIONS, forces=found.load_number * forces[0])
            if not steps[-1].converged:
                counts.failed_s += watch.cpu_s["newton"] - before
            for step in steps:
                if step.converged:
                    with watch("voxelise"):
                        fine(step.displacement)
                    with watch("stress"):
                        fine.at_rest(von_mises(solver, step))
                    counts.nonlinear += 1
                else:
                    counts.dropped += 1
        counts.bodies += 1
    return watch, counts
