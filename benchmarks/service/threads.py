"""Which way to run the networks is fastest: threads, spinning, arena, measured in turns.

    python -m benchmarks.service.threads [--repeats 30]

Every configuration runs both networks with the inputs of the bundled question in every turn, so that what else the
machine does meets all alike: one run right after another, and one after a pause of 20 ms, as between the frames of a
camera, in which the cores fall asleep. Written: the median wall time of both together with and without the pause, and
the processor time, which is what another program on the robot's computer loses. Only a quiet machine tells.
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
from service.inference.helpers import Helpers
from service.inference.registry import load_models
from service.settings import Settings, available_cores

PAUSE_S = 0.02

RESULTS = Path(__file__).resolve().parent / "results"


def configurations(cores: int) -> dict[str, dict[str, Any]]:
    """What is compared with what is served, by name."""
    plain = {"threads": 1, "spin": "0", "stop": "0", "arena": True, "pattern": True}
    return {
        "one thread": plain,
        "as many as cores, wherever they wake": {**plain, "threads": cores},
        "these spinning": {**plain, "threads": cores, "spin": "1"},
        "these spinning, stopped after each run": {**plain, "threads": cores, "spin": "1", "stop": "1"},
        "one thread, no arena": {**plain, "arena": False},
        "one thread, no memory pattern": {**plain, "pattern": False},
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
    served = load_models(settings.models, settings.threads, available_cores()).graphs
    helpers = Helpers()
    feeds = [_inputs(graph.manifest.inputs) for graph in served]
    networks = {"served": served}
    for name, chosen in configurations(available_cores()).items():
        networks[name] = tuple(_reopened(graph, settings.models, chosen) for graph in served)
    times: dict[str, dict[str, list[float]]] = {
        name: {"median_ms": [], "after_pause_ms": [], "processor_ms": []} for name in networks
    }
    for _ in range(given.repeats):
        for name, pair in networks.items():
            time.sleep(PAUSE_S)  # whoever still spins has stopped
            for column in ("warm-up", "median_ms", "after_pause_ms"):
                if column == "after_pause_ms":
                    time.sleep(PAUSE_S)
                began, used = time.perf_counter(), time.process_time()
                if name == "served":
                    helpers.keep_off()
                for network, feed in zip(pair, feeds, strict=True):
                    network.run(feed)
                if column in times[name]:
                    times[name][column].append(1e3 * (time.perf_counter() - began))
                if column == "median_ms":
                    times[name]["processor_ms"].append(1e3 * (time.process_time() - used))
    rows = {name: {key: float(np.median(found)) for key, found in each.items()} for name, each in times.items()}
    RESULTS.mkdir(exist_ok=True)
    document = {"configurations": rows, "load_average": os.getloadavg(), "repeats": given.repeats}
    (RESULTS / "threads.json").write_text(json.dumps(document, indent=1) + "\n", "utf-8")
    for name, row in rows.items():
        print(f"{name:38s}", "  ".join(f"{key.removesuffix('_ms')} {ms:.1f}" for key, ms in row.items()), "ms")


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
