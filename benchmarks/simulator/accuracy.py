"""How far the simulator's answers are from those on finer cells, and what it costs to be closer.

Scenes are the first push on each body of the `everyday` set, at the force chosen there, solved with that force on
coarse cells with either element, on finer cells, and on 48³ cells as reference. Every solved scene is kept in
`accuracy.jsonl`, so that a run that was stopped goes on where it was.

    python -m benchmarks.simulator.accuracy --scenes 40
    python -m benchmarks.simulator.accuracy --refinement docs/images/refinement.png
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.simulator.refinement import plot_refinement
from training.data.everyday import EverydayConfig, draw_body, draw_load
from training.data.generate import Dropped
from training.metrics import iou
from training.simulation.body import Body, BodyError
from training.simulation.enhanced import EnhancedHexahedron
from training.simulation.gaps import narrow_gaps
from training.simulation.loads import Load, LoadError
from training.simulation.mean_dilatation import MeanDilatationHexahedron
from training.simulation.newton import solve_neo_hookean
from training.simulation.rasterise import Rasterised, Rasteriser
from training.simulation.shapes import Shape
from training.simulation.solver import LinearSolver

RESULTS = Path(__file__).parent / "results"
ELEMENTS = {"plain": MeanDilatationHexahedron, "enhanced": EnhancedHexahedron}
METHODS = ("plain", "enhanced", "plain32")
LADDER = (8, 12, 16, 24, 32)
"""Cells of the methods on the plot of accuracy against time."""
FRACTIONS = (0.4, 0.7, 1.0)


@dataclass(frozen=True)
class Scene:
    """One push on one body, in the unit cube."""

    index: int
    family: str
    shape: Shape
    cells: int
    poisson_ratio: float
    load: Load
    gaps: float
    thickness: float
    foot: float


def foot_radius(body: Body) -> float:
    """Radius of gyration of what stands on the ground, across its narrowest direction, in units of L."""
    weight = np.asarray(body.foundation.sum(axis=1)).ravel()
    place = body.node_positions[:, :2] - weight @ body.node_positions[:, :2] / weight.sum()
    return float(np.sqrt(np.linalg.eigvalsh((place * weight[:, None]).T @ place / weight.sum())[0]))


def draw_scene(config: EverydayConfig, index: int) -> Scene | str:
    """The first push of a body that `everyday` draws, or why it has none."""
    try:
        drawn = draw_body(config, index)
        body, nu = drawn.body, drawn.material.poisson_ratio
        chosen = draw_load(config, drawn, LinearSolver(body, nu), drawn.pushes[0])
    except (Dropped, LoadError) as error:
        return error.reason
    if chosen is None:
        return "no_force"
    gaps, foot = narrow_gaps(body), foot_radius(body)
    return Scene(index, drawn.name, drawn.shape, body.cells, nu, chosen.load, gaps, drawn.thickness, foot)


@dataclass(frozen=True)
class Answer:
    """Voxels of every load step that converged, by its share of the load, and what it took."""

    voxels: dict[float, Rasterised]
    reason: str | None
    time_s: float


def solve(scene: Scene, element: str, cells: int, law: str = "neo_hookean") -> Answer:
    """Follow a scene's load on some cells; times are of set-up, factor and solution, without the voxels."""
    start = time.process_time()
    try:
        body = Body.from_distance(scene.shape.distance, cells)
        solver = LinearSolver(body, scene.poisson_ratio, ELEMENTS[element])
        if law == "linear":
            displacement = solver.solve([scene.load])[0]
            states, reason = {fraction: fraction * displacement for fraction in FRACTIONS}, None
        else:
            steps = solve_neo_hookean(solver, scene.load, FRACTIONS)
            states, reason = {step.fraction: step.displacement for step in steps if step.converged}, steps[-1].reason
    except (BodyError, LoadError) as error:
        return Answer({}, error.reason, time.process_time() - start)
    time_s = time.process_time() - start
    rasteriser = Rasteriser(body)
    return Answer({fraction: rasteriser(state) for fraction, state in states.items()}, reason, time_s)


def ladder() -> list[tuple[str, str, int]]:
    """Law, element and cells of every method on the plot of accuracy against time."""
    laws, elements = ("linear", "neo_hookean"), tuple(ELEMENTS)
    return [(law, element, cells) for law in laws for element in elements for cells in LADDER]


def study(config: EverydayConfig, index: int) -> dict[str, Any]:
    """All solutions of a scene, compared at the largest share of the load that the coarse and the fine cells carry."""
    scene = draw_scene(config, index)
    if isinstance(scene, str):
        return {"index": index, "dropped": scene}
    coarse = solve(scene, "plain", scene.cells)
    if not coarse.voxels:
        return {"index": index, "dropped": coarse.reason}
    reference = solve(scene, "plain", 48)
    shared = set(reference.voxels) & set(coarse.voxels)
    if not shared:
        return {"index": index, "dropped": f"reference {reference.reason}"}
    fraction = max(shared)
    truth = reference.voxels[fraction]
    answers = {"plain": coarse, "enhanced": solve(scene, "enhanced", scene.cells)}
    if scene.cells < 32:
        answers["plain32"] = solve(scene, "plain", 32)
    for law, element, cells in ladder():
        if law == "neo_hookean" and cells == scene.cells:
            answers[f"{law} {element} {cells}"] = answers[element]
        else:
            answers[f"{law} {element} {cells}"] = solve(scene, element, cells, law)
    cases: dict[str, dict[str, Any]] = {}
    for name, answer in answers.items():
        cases[name] = {"reason": answer.reason, "time_s": answer.time_s}
        if fraction in answer.voxels:
            voxels = answer.voxels[fraction]
            cases[name]["iou"] = iou(voxels.deformed, truth.deformed)
            cases[name]["peak_error"] = voxels.peak_displacement / truth.peak_displacement - 1.0
    return {
        "index": index,
        "family": scene.family,
        "cells": scene.cells,
        "poisson_ratio": scene.poisson_ratio,
        "gaps": scene.gaps,
        "foot_cells": scene.foot * scene.cells,
        "thickness_cells": scene.thickness * scene.cells,
        "fraction": fraction,
        "peak": truth.peak_displacement,
        "identity_iou": iou(Rasteriser(Body.from_distance(scene.shape.distance, 24)).rest, truth.deformed),
        "reference": {"reason": reference.reason, "time_s": reference.time_s},
        **cases,
    }


def table(rows: list[dict]) -> str:
    """Markdown: one line a method, over the scenes that both it and the reference solved."""
    lines = [
        "| cells and element | scenes | mean IoU | 10th percentile | peak error, median | 90th percentile | CPU s |",
        "|---|---|---|---|---|---|---|",
    ]
    for name in METHODS:
        # bodies drawn for 32³ cells have one solution there
        own = [row[name if name in row else name.removesuffix("32")] for row in rows]
        good = [case for case in own if "iou" in case]
        if not good:
            continue
        overlap = np.array([case["iou"] for case in good])
        error = np.abs([case["peak_error"] for case in good])
        seconds = np.mean([case["time_s"] for case in good])
        lines.append(
            f"| {name} | {len(good)} of {len(rows)} | {overlap.mean():.3f} | {np.quantile(overlap, 0.1):.3f} "
            f"| {np.median(error):.1%} | {np.quantile(error, 0.9):.1%} | {seconds:.2f} |"
        )
    worst = sorted((row for row in rows if "iou" in row.get("plain", {})), key=lambda row: row["plain"]["iou"])[:10]
    lines += [
        "",
        "Worst scenes on the cells of the data set, plain element:",
        "",
        "| scene | family | thickness, cells | foot, cells | gaps | IoU | peak error | enhanced: IoU | peak error |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for row in worst:
        other = row["enhanced"]
        second = f"{other['iou']:.3f} | {other['peak_error']:+.0%}" if "iou" in other else f"{other['reason']} |"
        lines.append(
            f"| {row['index']} | {row['family']} | {row['thickness_cells']:.1f} | {row['foot_cells']:.1f} "
            f"| {row['gaps']:.3f} | {row['plain']['iou']:.3f} | {row['plain']['peak_error']:+.0%} | {second} |"
        )
    lines += ["", *frontier_lines(rows)]
    return "\n".join(lines) + "\n"


def frontier(rows: list[dict], law: str, element: str, cells: int) -> tuple[float, float, float, int]:
    """Seconds, mean IoU, its 10th percentile and the number of answers; the body at rest counts where there is none."""
    cases = [row[f"{law} {element} {cells}"] for row in rows]
    overlap = [case.get("iou", row["identity_iou"]) for case, row in zip(cases, rows, strict=True)]
    answered = sum("iou" in case for case in cases)
    seconds = float(np.mean([case["time_s"] for case in cases]))
    return seconds, float(np.mean(overlap)), float(np.quantile(overlap, 0.1)), answered


def frontier_lines(rows: list[dict]) -> list[str]:
    """Accuracy against time, one line a method."""
    identity = np.array([row["identity_iou"] for row in rows])
    reference = np.mean([row["reference"]["time_s"] for row in rows])
    lines = [
        f"Against 48³ neo-Hookean plain cells ({reference:.1f} s of processor time a scene); the body at rest has a "
        f"mean IoU of {identity.mean():.3f} and stands in where a method gives no answer. Times are of set-up, factor "
        "and solution of one load, without voxels.",
        "",
        "| law | element | cells | ms | mean IoU | 10th percentile | answers |",
        "|---|---|---|---|---|---|---|",
    ]
    for law, element, cells in ladder():
        seconds, mean, tenth, answered = frontier(rows, law, element, cells)
        figures = f"{1e3 * seconds:.0f} | {mean:.3f} | {tenth:.3f} | {answered} of {len(rows)}"
        lines.append(f"| {law} | {element} | {cells}³ | {figures} |")
    return lines


def plot(rows: list[dict], path: Path) -> None:
    """Overlap with the reference, sorted, for every method."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(13.0, 3.8), constrained_layout=True)
    for name in METHODS:
        good = [row[name] for row in rows if "iou" in row.get(name, {})]
        if good:
            share = (np.arange(len(good)) + 0.5) / len(good)
            axes[0].plot(share, np.sort([case["iou"] for case in good]), label=name)
            axes[1].plot(share, np.sort(np.abs([case["peak_error"] for case in good])), label=name)
    axes[0].axhline(0.97, color="0.6", linestyle=":")
    axes[0].set(xlabel="share of the scenes", ylabel="IoU with 48³ cells")
    axes[1].set(xlabel="share of the scenes", ylabel="error of the peak displacement", yscale="log")
    axes[0].legend()
    for law, line in (("linear", "--"), ("neo_hookean", "-")):
        for element, mark in (("plain", "o"), ("enhanced", "s")):
            points = [frontier(rows, law, element, cells) for cells in LADDER]
            label = f"{law.replace('_', '-')}, {element}"
            axes[2].plot([1e3 * point[0] for point in points], [point[1] for point in points], line + mark, label=label)
            for point, cells in zip(points, LADDER, strict=True):
                axes[2].annotate(f"{cells}³", (1e3 * point[0], point[1]), fontsize=7)
    axes[2].axhline(np.mean([row["identity_iou"] for row in rows]), color="0.6", linestyle=":", label="body at rest")
    axes[2].set(xlabel="processor time of one load, ms", ylabel="mean IoU with 48³ cells", xscale="log")
    axes[2].legend(fontsize=7)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Run the study, or plot convergence under refinement."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenes", type=int, default=40, help="scenes to solve")
    parser.add_argument("--seed", type=int, default=0, help="of the everyday set")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder of accuracy.jsonl, .md and .png")
    parser.add_argument("--refinement", type=Path, help="write the plot of convergence under refinement here, and stop")
    arguments = parser.parse_args()
    if arguments.refinement:
        plot_refinement(arguments.refinement)
        return
    arguments.out.mkdir(parents=True, exist_ok=True)
    log = arguments.out / "accuracy.jsonl"
    rows = [json.loads(line) for line in log.read_text().splitlines()] if log.exists() else []
    config = replace(EverydayConfig(), seed=arguments.seed)
    index = rows[-1]["index"] + 1 if rows else 0
    with log.open("a") as file, get_context("spawn").Pool(arguments.workers) as pool:
        for row in pool.imap(partial(study, config), range(index, 100 * arguments.scenes)):
            if sum("plain" in kept for kept in rows) >= arguments.scenes:
                break
            rows.append(row)
            print(json.dumps(row), file=file, flush=True)
            print(json.dumps(row), flush=True)
    kept = [row for row in rows if "plain" in row][: arguments.scenes]
    (arguments.out / "accuracy.md").write_text(table(kept))
    plot(kept, arguments.out / "accuracy.png")
    print(table(kept))


if __name__ == "__main__":
    main()
