"""How many finished samples the simulator gives a minute on one core, where the time goes, and the memory it takes.

A linear sample is finished when it is solved, its force is chosen, and its deformed occupancy on 64³ voxels is known,
with its backward and forward field and its stress at every voxel of the body; all loads of a body share one factor.
Drawing a body (`draw`), packing samples as a data set keeps them (`pack`) and writing them (`store`) are timed beside
that. Wall and processor time are both taken: where they differ, the machine was not quiet.

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
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.simulator.oracle import measure_oracle
from benchmarks.simulator.stages import A_BODY, A_SAMPLE, BESIDE, ELEMENTS, Counts, measure_linear, measure_nonlinear
from benchmarks.simulator.throughput_report import markdown, processor
from training.data.everyday import EverydayConfig, draw_group
from training.data.generate import THREAD_VARIABLES, Dropped
from training.data.store import Store


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
            "of_newton_in_loads_that_fail": nonlinear.failed_s / nonlinear_watch.cpu_s["newton"],
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
    parser.add_argument("--bodies", type=int, default=20)
    parser.add_argument("--loads", type=int, default=64, help="linear loads on each body")
    parser.add_argument("--nonlinear-bodies", type=int, default=20)
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
