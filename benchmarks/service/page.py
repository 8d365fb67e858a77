"""The tables of docs/performance.md, rewritten from what was measured."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

RESULTS = Path(__file__).resolve().parent / "results"
PAGE = Path(__file__).resolve().parents[2] / "docs" / "performance.md"


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
    if again := rows.get("ask again"):
        lines += [
            "",
            f"Asking again by `reconstruction_id`, one load, takes {again['p50_ms']:.1f} ms at the median and "
            f"{again['p99_ms']:.1f} at the 99th percentile over gRPC (client's decoding included).",
        ]
    if what_if := rows.get("what if"):
        lines += [
            "",
            f"32 loads in one request take {what_if['many_ms']:.0f} ms, {what_if['ratio']:.1f} times the "
            f"{what_if['one_ms']:.0f} ms of one.",
        ]
    if fair := rows.get("four streams of 30/s"):
        lines += ["", f"The four streams had {', '.join(map(str, fair['answers_per_client']))} answers."]
    return lines + _standard_tools(rows)


def _standard_tools(rows: dict[str, Any]) -> list[str]:
    lines = []
    if (k6 := rows.get("k6")) and "failed_share" in k6:
        lines += [
            "",
            f"k6, HTTP multipart at {k6['rate_hz']:.0f}/s: median {k6['p50_ms']:.1f}, 99th percentile "
            f"{k6['p99_ms']:.1f} ms, {100.0 * k6['failed_share']:.1f} % failed.",
        ]
    if (triton := rows.get("tritonclient")) and "p50_ms" in triton:
        lines += [
            "",
            "`tritonclient` over gRPC, the cascade with a float frame of 480×640, one question after the other: "
            f"median {triton['p50_ms']:.1f}, 99th percentile {triton['p99_ms']:.1f} ms.",
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
        "| configuration | median ms | after a pause of 20 ms | processor ms |",
        "|---|---|---|---|",
    ]
    for name, row in document["configurations"].items():
        lines.append(f"| {name} | {row['median_ms']:.1f} | {row['after_pause_ms']:.1f} | {row['processor_ms']:.1f} |")
    return lines


def _ms(value: float | None) -> str:
    return "–" if value is None else f"{value:.1f}"
