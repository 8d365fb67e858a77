"""What the timing of the simulator found, as a page."""

from __future__ import annotations

import platform
from pathlib import Path
from typing import Any

TARGETS = {"linear": 5000, "nonlinear": 200, "memory_gb": 1.5}


def processor() -> str:
    """Name of the processor."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def markdown(result: dict[str, Any]) -> str:
    """The result as a page."""
    linear, nonlinear, oracle, config = (result[key] for key in ("linear", "nonlinear", "scikit_fem", "configuration"))
    load = result["machine"]["load_average"][0]
    lines = [
        "# Throughput of the simulator on one core",
        "",
        f"`python -m benchmarks.simulator.throughput --bodies {config['bodies']} --loads {config['loads']}` on "
        f"{result['machine']['processor']}, one thread, load average {load:.1f}; {config['cells']}³ cells, "
        f"{config['element']} element, {result['bodies']} bodies of {result['mean_cells']:.0f} cells on average.",
        "",
        "| | processor time | wall time | wanted |",
        "|---|---|---|---|",
        f"| finished linear samples a minute | {linear['per_minute_cpu']:.0f} | {linear['per_minute_wall']:.0f} | "
        f"{TARGETS['linear']} |",
        f"| … with drawing, packing and writing | {linear['with_draw_pack_store_per_minute_cpu']:.0f} | | |",
        f"| nonlinear samples a minute | {nonlinear['per_minute_cpu']:.0f} | {nonlinear['per_minute_wall']:.0f} | "
        f"{TARGETS['nonlinear']} |",
    ]
    if result["everyday"]:
        everyday = result["everyday"]
        lines.append(
            f"| `everyday`, drawn and written, samples a minute | {everyday['per_minute_cpu']:.0f} | "
            f"{everyday['per_minute_wall']:.0f} | |"
        )
    lines += [
        f"| peak memory of a worker, GB | {result['memory_gb']:.2f} | | {TARGETS['memory_gb']} |",
        "",
        "## Where the time goes (processor milliseconds)",
        "",
        f"| stage | a body | a sample at {config['loads']} loads |",
        "|---|---|---|",
    ]
    each = result["bodies"] / linear["samples"]
    lines += [f"| {stage} | {ms:.1f} | {ms * each:.2f} |" for stage, ms in linear["a_body_ms"].items()]
    lines += [f"| {stage} | | {ms:.2f} |" for stage, ms in linear["a_sample_ms"].items()]
    lines += [
        "",
        "Nonlinear, a sample: " + ", ".join(f"{k} {ms:.1f} ms" for k, ms in nonlinear["a_sample_ms"].items()) + ".",
        f"Of `newton` {nonlinear['of_newton_in_loads_that_fail']:.0%} goes into loads that do not reach their full "
        "force; their converged steps count as samples.",
        "",
        "## Beside scikit-fem",
        "",
        f"One load on one body of {oracle['cells']} cells, trilinear elements, ν = 0.3, processor seconds:",
        "",
        "| | seconds | ratio to ours |",
        "|---|---|---|",
        f"| ours: sparsity, assembly, factor, solve | {oracle['ours_s']:.3f} | 1 |",
    ]
    for key, name in (("skfem_superlu_s", "its own solver (SuperLU)"), ("skfem_pardiso_s", "MKL PARDISO")):
        if key in oracle:
            total = oracle["skfem_assembly_s"] + oracle[key]
            lines.append(f"| scikit-fem: assembly, {name} | {total:.3f} | {total / oracle['ours_s']:.1f} |")
    return "\n".join(lines) + "\n"
