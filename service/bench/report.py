"""What was measured, for people and for machines."""

from __future__ import annotations

import math
import os
import platform
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

from service.bench.histogram import Histogram
from service.bench.open_loop import Measured
from service.bench.process import RunningService
from service.bench.targets import OK, SKIPPED

PERCENTILES = (50.0, 90.0, 99.0, 99.9)
_PACKAGES = ("physnet", "numpy", "opencv-python-headless", "onnxruntime", "grpcio", "protobuf", "uvicorn", "uvloop")


def machine() -> dict[str, Any]:
    """What a figure depends on: the processor, its load before we began, and the versions."""
    versions: dict[str, str | None] = {}
    for name in _PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = None
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load_average": list(os.getloadavg()) if hasattr(os, "getloadavg") else None,
        "system": platform.platform(),
        "python": platform.python_version(),
        "versions": versions,
    }


def run_document(measured: Measured, service: RunningService | None = None) -> dict[str, Any]:
    """One run as JSON can hold it; NaN becomes None."""
    asked = sum(measured.outcomes.values())
    document: dict[str, Any] = {
        "asked": asked,
        "answered": measured.outcomes[OK],
        "skipped": measured.outcomes[SKIPPED],
        "failed": asked - measured.outcomes[OK] - measured.outcomes[SKIPPED],
        "outcomes": dict(measured.outcomes),
        "elapsed_s": measured.elapsed_s,
        "clients": measured.clients,
        "answers_per_client": [measured.per_client[client] for client in range(measured.clients)],
        "latency_ms": percentiles(measured.latency),
        "lag_ms": percentiles(measured.lag),
        "stages_ms": measured.stage_medians_ms(),
    }
    if service is not None:
        document["service"] = {
            "ready_s": service.ready_s,
            "resident_mib": service.resident_mib(),
            "peak_mib": service.peak_mib(),
            "cpu_s": service.cpu_s(),
            "memory_mib": [[round(at_s, 1), round(mib, 1)] for at_s, mib in service.memory],
        }
    plain: dict[str, Any] = jsonable(document)
    return plain


def line(measured: Measured, questions: int) -> str:
    """Where a run stands: `  asked 61 of 300  answered 60  skipped 1  failed 0  p50 23 ms`."""
    outcomes = measured.outcomes.copy()  # the run goes on meanwhile
    answered, skipped, asked = outcomes[OK], outcomes[SKIPPED], outcomes.total()
    p50 = f"  p50 {measured.latency.percentile(50.0):.0f} ms" if answered else ""
    counts = f"answered {answered}  skipped {skipped}  failed {asked - answered - skipped}"
    return f"  asked {asked} of {questions}  {counts}{p50}"


def percentiles(histogram: Histogram) -> dict[str, float]:
    """`p50`, `p90`, `p99`, `p99.9`, `max` and `mean`, ms."""
    found = {f"p{percent:g}": histogram.percentile(percent) for percent in PERCENTILES}
    return {**found, "max": histogram.largest_ms, "mean": histogram.mean_ms}


def jsonable(value: Any) -> Any:
    """JSON has no NaN: None in its place."""
    if isinstance(value, Mapping):
        return {key: jsonable(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [jsonable(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def table(document: Mapping[str, Any]) -> list[str]:
    """A run for a terminal."""
    latency = document["latency_ms"]
    lines = [
        f"{document['asked']} asked in {document['elapsed_s']:.1f} s by {document['clients']} client(s): "
        f"{document['answered']} answered, {document['skipped']} skipped, {document['failed']} failed"
    ]
    failures = {code: count for code, count in document["outcomes"].items() if code not in (OK, SKIPPED)}
    if failures:
        lines.append("failures      " + ", ".join(f"{code} {count}" for code, count in sorted(failures.items())))
    if document["clients"] > 1:
        lines.append("each client   " + ", ".join(map(str, document["answers_per_client"])) + " answers")
    lines.append("              " + "".join(f"{name:>9s}" for name in latency))
    for title, times in (("latency ms", latency), ("late by ms", document["lag_ms"])):
        lines.append(f"{title:14s}" + "".join(f"{_number(value):>9s}" for value in times.values()))
    if document["stages_ms"]:
        stages = "  ".join(f"{stage} {ms:.1f}" for stage, ms in document["stages_ms"].items())
        lines.append(f"stages ms     {stages}  (medians)")
    if "service" in document:
        service = document["service"]
        lines.append(
            f"service       ready in {_number(service['ready_s'])} s, {_number(service['resident_mib'])} MiB resident, "
            f"{_number(service['peak_mib'])} MiB at most, {_number(service['cpu_s'])} s of processor time"
        )
    if "graphs" in document:
        graphs = document["graphs"]
        bare = " + ".join(f"{name} {ms:.1f}" for name, ms in graphs["medians_ms"].items())
        lines.append(
            f"graphs        {graphs['sum_ms']:.1f} ms bare ({bare}); the service's p50 alone is "
            f"{graphs['service_p50_ms']:.1f} ms, {graphs['ratio']:.2f} times that"
        )
    return lines


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def _processor() -> str:
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()
