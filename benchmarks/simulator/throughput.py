"""How many finished samples the simulator gives a minute on one core, where the time goes, and the memory it takes.

A linear sample is finished when it is solved, its force is chosen, and its deformed occupancy on 64³ voxels is known,
with its backward and forward field at every voxel of the body; all loads of a body share one factor. Drawing a body
(`draw`), packing samples as a data set keeps them (`pack`) and writing them (`store`) are timed beside that. Wall and
processor time are both taken: where they differ, the machine was not quiet.

    python -m benchmarks.simulator.throughput

takes two minutes on a quiet core.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.simulator.oracle import measure_oracle
from benchmarks.simulator.throughput_report import markdown, processor
from service.core.grids import pack_bits
from training.data.body_cube import place_in_body_grid
from training.data.everyday import EverydayConfig, draw_group
from training.data.fields import coarsen, extend
from training.data.generate import THREAD_VARIABLES, Dropped
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

ELEMENTS = {"mean-dilatation": MeanDilatationHexahedron, "enhanced": EnhancedHexahedron}
A_BODY = ("fill", "number", "contacts", "rest", "skin", "assembly", "factor")
"""Stages that all samples of a body share."""
A_SAMPLE = ("load", "solve", "force search", "voxelise")
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
    """What was finished."""

    bodies: int = 0
    linear: int = 0
    nonlinear: int = 0
    dropped: int = 0
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
        counts.linear += 1
        with watch("pack"):
            columns = {"deformed": pack_bits(result.deformed)}
            fields = {
                "displacement": (np.flatnonzero(result.deformed), result.moved_here),
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
                displacement = solver.solve([load])[0]
                found = force_for_identity_iou(overlap, load, displacement, float(rng.uniform(0.30, 0.85)))
            if found is None:
                continue
            with watch("newton"):
                steps = solve_neo_hookean(solver, found, FRACTIONS)
            for step in steps:
                if step.converged:
                    with watch("voxelise"):
                        fine(step.displacement)
                    counts.nonlinear += 1
                else:
                    counts.dropped += 1
        counts.bodies += 1
    return watch, counts


def measure_everyday(args: argparse.Namespace) -> dict[str, float]:
    """The default data set as it is drawn and written, with everything that entails."""
    samples, groups, wall, cpu = 0, 0, time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        store = Store(Path(folder))
        for index in range(1000):
            if groups == args.groups:
                break
            try:
                group = draw_group(EverydayConfig(seed=args.seed), index)
            except Dropped:
                continue
            store.write_group(index, group)
            samples, groups = samples + len(group["sample"]), groups + 1
    wall, cpu = time.perf_counter() - wall, time.process_time() - cpu
    return {"groups": groups, "samples": samples, "per_minute_wall": 60 * samples / wall,
            "per_minute_cpu": 60 * samples / cpu}  # fmt: skip


def per_minute(seconds: dict[str, float], counts: Counts, stages: tuple[str, ...]) -> float:
    """Finished linear samples a minute of these stages."""
    return 60.0 * counts.linear / sum(seconds[stage] for stage in stages)


def report(args: argparse.Namespace) -> dict[str, Any]:
    """Measure everything."""
    measure_linear(argparse.Namespace(**{**vars(args), "bodies": 1, "loads": 2, "seed": 99}))  # compile, load libraries
    watch, counts, bodies = measure_linear(args)
    nonlinear_watch, nonlinear = measure_nonlinear(args, bodies[: args.nonlinear_bodies])
    everyday = measure_everyday(args) if args.groups else None
    memory_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6  # KiB on Linux; before the oracle runs
    oracle = measure_oracle(sorted(bodies, key=lambda body: len(body.active))[len(bodies) // 2])
    stages = A_BODY + A_SAMPLE
    return {
        "configuration": {key: value for key, value in vars(args).items() if key != "out"},
        "machine": {"processor": processor(), "python": platform.python_version(), "load_average": os.getloadavg()},
        "bodies": counts.bodies,
        "mean_cells": float(np.mean(counts.cells)),
        "linear": {
            "samples": counts.linear,
            "force_not_found": counts.dropped,
            "per_minute_wall": per_minute(watch.wall_s, counts, stages),
            "per_minute_cpu": per_minute(watch.cpu_s, counts, stages),
            "with_draw_pack_store_per_minute_cpu": per_minute(watch.cpu_s, counts, stages + BESIDE),
            "a_body_ms": {stage: 1e3 * watch.cpu_s[stage] / counts.bodies for stage in (*A_BODY, "draw")},
            "a_sample_ms": {stage: 1e3 * watch.cpu_s[stage] / counts.linear for stage in (*A_SAMPLE, "pack", "store")},
        },
        "nonlinear": {
            "samples": nonlinear.nonlinear,
            "not_converged": nonlinear.dropped,
            "per_minute_wall": 60 * nonlinear.nonlinear / sum(nonlinear_watch.wall_s.values()),
            "per_minute_cpu": 60 * nonlinear.nonlinear / sum(nonlinear_watch.cpu_s.values()),
            "a_sample_ms": {k: 1e3 * s / nonlinear.nonlinear for k, s in nonlinear_watch.cpu_s.items()},
        },
        "everyday": everyday,
        "memory_gb": memory_gb,
        "scikit_fem": oracle,
    }  # fmt: skip


def pin_to_one_thread() -> None:
    """Start again with one thread: the libraries read their number of threads when they load."""
    if any(os.environ.get(variable) != "1" for variable in THREAD_VARIABLES):
        os.execve(sys.executable, sys.orig_argv, {**os.environ, **dict.fromkeys(THREAD_VARIABLES, "1")})


def main() -> None:
    pin_to_one_thread()
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bodies", type=int, default=8)
    parser.add_argument("--loads", type=int, default=64, help="linear loads on each body")
    parser.add_argument("--nonlinear-bodies", type=int, default=6)
    parser.add_argument("--nonlinear-loads", type=int, default=3)
    parser.add_argument("--groups", type=int, default=4, help="groups of `everyday` to draw and write; 0: none")
    parser.add_argument("--cells", type=int, default=24)
    parser.add_argument("--element", choices=sorted(ELEMENTS), default="mean-dilatation")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder of throughput.md and .json")
    args = parser.parse_args()
    result = report(args)
    args.out.mkdir(parents=True, exist_ok=True)
    (args.out / "throughput.json").write_text(json.dumps(result, indent=1) + "\n")
    (args.out / "throughput.md").write_text(markdown(result))
    print(markdown(result))


if __name__ == "__main__":
    main()
