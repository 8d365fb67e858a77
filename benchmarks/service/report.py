"""Every figure of docs/performance.md in one run, and the page's tables rewritten from it.

    python -m benchmarks.service.report [--duration 60] [--only NAME …] [--tables-only]

Starts the service anew for each row, asks it as a robot does (`physnet bench`), and writes `results/latency.json` and a
picture of each row. `--tables-only` rewrites the page from the results that are there. Takes about seven minutes; only
a quiet machine tells, and its load average before each row is written down with it.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from service.bench import report
from service.bench.open_loop import closed_loop, open_loop
from service.bench.picture import picture
from service.bench.process import running_service
from service.bench.question import sample_question
from service.bench.targets import make_target
from service.commands.bench import against_graphs
from service.settings import Settings

ROOT = Path(__file__).resolve().parents[2]
RESULTS = Path(__file__).resolve().parent / "results"
PAGE = ROOT / "docs" / "performance.md"


@dataclass(frozen=True)
class Row:
    """One run of the open loop: `rate_hz` questions a second of each client, for a share of the whole duration."""

    name: str
    target: str
    rate_hz: float
    clients: int = 1
    share: float = 1.0


ROWS = (
    Row("gRPC stream, 30/s", "grpc-stream", 30.0),
    Row("gRPC unary, 30/s", "grpc", 30.0),
    Row("HTTP multipart, 30/s", "http-multipart", 30.0),
    Row("HTTP JSON, 30/s", "http-json", 30.0),
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
    return {**found, "graphs": _graphs, "what if": _what_if}


def _run(row: Row, duration_s: float) -> dict[str, Any]:
    with _service() as service:
        targets = [make_target(row.target, service.http, service.grpc, sample_question()) for _ in range(row.clients)]
        measured = asyncio.run(open_loop(targets, row.rate_hz, duration_s))
        drawing = RESULTS / f"{row.name.replace(' ', '-').replace(',', '').replace(':', '').replace('/', '-')}.svg"
        drawing.write_text(picture(measured, row.name), "utf-8")
        return report.run_document(measured, service)


def _graphs() -> dict[str, Any]:
    settings = Settings()
    with _service() as service:
        return against_graphs("grpc-stream", service, settings, sample_question(), repeats=100)


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


# --- the page ---------------------------------------------------------------------------------------------------


def rewrite_page(document: dict[str, Any]) -> None:
    """Put each table between its markers, `<!-- NAME -->` and `<!-- end -->`; one without results stays as it is."""
    text = PAGE.read_text("utf-8")
    for name, make in (("latency", _latency_table), ("stages", _stage_table), ("threads", _thread_table)):
        lines = make(document)
        if not lines:
            continue
        head, begin, rest = text.partition(f"<!-- {name} -->\n")
        _, end, tail = rest.partition("<!-- end -->")
        if not (begin and end):
            raise ValueError(f"{PAGE} has no place for the table `{name}`")
        text = head + begin + "\n".join(lines) + "\n" + end + tail
    PAGE.write_text(text, "utf-8")


def _latency_table(document: dict[str, Any]) -> list[str]:
    rows = document["rows"]
    if not rows:
        return []
    machine = document["machine"]
    lines = [
        f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, "
        f"onnxruntime {machine['versions']['onnxruntime']}, OpenCV {machine['versions']['opencv-python-headless']}.",
        "",
        "| asked | p50 ms | p99 ms | p99.9 ms | answered | skipped | failed | resident MiB | load before |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name, row in rows.items():
        if "latency_ms" in row:
            latency = row["latency_ms"]
            cells = [_ms(latency[key]) for key in ("p50", "p99", "p99.9")]
            cells += [str(row[key]) for key in ("answered", "skipped", "failed")]
            cells += [_ms(row["service"]["resident_mib"]), f"{row['load_average']:.1f}"]
            lines.append(f"| {name} | " + " | ".join(cells) + " |")
    ready = [row["service"]["ready_s"] for row in rows.values() if "service" in row]
    if ready:
        lines += ["", f"Ready {min(ready):.1f} to {max(ready):.1f} s after the start of the process."]
    if graphs := rows.get("graphs"):
        bare = " + ".join(f"{name} {ms:.1f}" for name, ms in graphs["medians_ms"].items())
        lines += [
            "",
            f"One question after the other over the stream takes {graphs['service_p50_ms']:.1f} ms at the median, "
            f"{graphs['ratio']:.2f} times the bare {bare} = {graphs['sum_ms']:.1f} ms measured in turns with it.",
        ]
    if what_if := rows.get("what if"):
        lines += [
            "",
            f"32 loads in one request take {what_if['many_ms']:.0f} ms, {what_if['ratio']:.1f} times the "
            f"{what_if['one_ms']:.0f} ms of one.",
        ]
    return lines


def _stage_table(_: dict[str, Any]) -> list[str]:
    tables = {}
    for name in ("before", "after"):
        path = RESULTS / f"stages-{name}.json"
        if not path.exists():
            return []
        frames = json.loads(path.read_text("utf-8"))["frames"].values()
        stages = {stage for frame in frames for stage in frame}
        tables[name] = {stage: float(np.mean([frame.get(stage, 0.0) for frame in frames])) for stage in stages}
    names = ("parse", "decode", "segment", "voxelize", "reconstruct: network", "reconstruct: around it", "align",
             "deform: prior", "deform: network", "deform: around it", "encode gRPC", "encode JSON")  # fmt: skip
    lines = ["| stage | before ms | after ms |", "|---|---|---|"]
    for stage in names:
        cells = [f"{tables[name][stage]:.1f}" if stage in tables[name] else "–" for name in ("before", "after")]
        lines.append(f"| {stage} | " + " | ".join(cells) + " |")
    return lines


def _thread_table(_: dict[str, Any]) -> list[str]:
    path = RESULTS / "threads.json"
    if not path.exists():
        return []
    document = json.loads(path.read_text("utf-8"))
    lines = [
        f"Both networks, {document['repeats']} turns, load average {document['load_average'][0]:.1f}.",
        "",
        "| configuration | median ms | least ms | processor ms |",
        "|---|---|---|---|",
    ]
    for name, row in document["configurations"].items():
        lines.append(f"| {name} | {row['median_ms']:.1f} | {row['least_ms']:.1f} | {row['processor_ms']:.1f} |")
    return lines


def _ms(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"


if __name__ == "__main__":
    main()
