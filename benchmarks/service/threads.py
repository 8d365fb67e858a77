"""Which way to run the networks is fastest: threads, spinning, arena, measured in turns.

    python -m benchmarks.service.threads [--repeats 30]

Every configuration runs both networks with the inputs of the bundled question, one run of each in every turn, so that
what else the machine does meets all alike. Written: the median and least wall time of both together, and the processor
time they take, which is what another program on the robot's computer loses. Only a quiet machine tells.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime

from service.inference.graph import Graph
from service.inference.registry import load_models
from service.settings import Settings, available_cores

RESULTS = Path(__file__).resolve().parent / "results"


def configurations(cores: int) -> dict[str, dict[str, Any]]:
    """What is compared, by name; the served one first."""
    served = {"threads": 1, "spin": "0", "stop": "0", "arena": True, "pattern": True}
    return {
        "served": served,
        "as many threads as cores": {**served, "threads": cores},
        "these spinning": {**served, "threads": cores, "spin": "1"},
        "these spinning, stopped after each run": {**served, "threads": cores, "spin": "1", "stop": "1"},
        "no arena": {**served, "arena": False},
        "no memory pattern": {**served, "pattern": False},
    }


def open_with(path: Path, chosen: dict[str, Any]) -> onnxruntime.InferenceSession:
    """A session of one configuration."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = chosen["threads"]
    options.inter_op_num_threads = 1
    options.enable_cpu_mem_arena = chosen["arena"]
    options.enable_mem_pattern = chosen["pattern"]
    options.add_session_config_entry("session.intra_op.allow_spinning", chosen["spin"])
    options.add_session_config_entry("session.force_spinning_stop", chosen["stop"])
    return onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])


def main() -> None:
    """Measure, print, write `results/threads.json`."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=30)
    given = parser.parse_args()
    settings = Settings()
    graphs = load_models(settings.models, 1).graphs
    feeds = [_inputs(graph.manifest.inputs) for graph in graphs]
    chosen = configurations(available_cores())
    networks = {name: [_reopened(graph, settings.models, how) for graph in graphs] for name, how in chosen.items()}
    wall: dict[str, list[float]] = {name: [] for name in networks}
    processor: dict[str, list[float]] = {name: [] for name in networks}
    for turn in range(given.repeats + 2):
        for name, pair in networks.items():
            began, used = time.perf_counter(), time.process_time()
            for network, feed in zip(pair, feeds, strict=True):
                network.run(feed)
            if turn >= 2:
                wall[name].append(1e3 * (time.perf_counter() - began))
                processor[name].append(1e3 * (time.process_time() - used))
    rows = {
        name: {
            **chosen[name],
            "median_ms": float(np.median(wall[name])),
            "least_ms": min(wall[name]),
            "processor_ms": float(np.median(processor[name])),
        }
        for name in networks
    }
    RESULTS.mkdir(exist_ok=True)
    document = {"configurations": rows, "load_average": os.getloadavg(), "repeats": given.repeats}
    (RESULTS / "threads.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    for name, row in rows.items():
        figures = (f"{key.removesuffix('_ms')} {row[key]:.1f}" for key in ("median_ms", "least_ms", "processor_ms"))
        print(f"{name:34s}", "  ".join(figures), "ms")


def _reopened(graph: Graph, models: Path, chosen: dict[str, Any]) -> Graph:
    folder = models / graph.manifest.name / graph.manifest.version
    return Graph(tuple(open_with(folder / name, chosen) for name in graph.manifest.graphs), graph.manifest)


def _inputs(specs: Any) -> dict[str, np.ndarray]:
    """A half-filled grid, one ordinary condition, zeros for the rest: time does not depend on values."""
    feeds = {}
    for spec in specs:
        shape = [size if isinstance(size, int) else 1 for size in spec.shape]
        feeds[spec.name] = np.zeros(shape, np.float32)
        if spec.name in ("rest", "view"):
            feeds[spec.name][..., 16:48, 16:48, :32] = 1.0
        if spec.name == "condition":
            feeds[spec.name][:] = (0.5, 0.5, 0.5, 0.0, 0.0, -1.0, -3.0, 0.3, 0.1)
    return feeds


if __name__ == "__main__":
    main()
