"""`physnet-train evaluate`: what a run is worth on bodies it has never seen, beside what it must beat."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any


def add_evaluate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = commands.add_parser(
        "evaluate",
        help="score a run on bodies it has never seen, and put it beside no motion, finite elements and others",
        description="Print the figures of a run on a whole split. With --out also write them, evaluation.json and "
        "evaluation.md; for a deformation network these hold it beside its rivals as well, one load at a time, and "
        "curves.svg, frontier.svg and worst.png are drawn.",
    )
    parser.add_argument("--run", dest="run_folder", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--split", choices=["validation", "test"], default="test")
    parser.add_argument("--out", type=Path, help="folder of the report")
    rivals = parser.add_argument_group("the report of a deformation network")
    rivals.add_argument("--samples", type=int, default=200, help="beside rivals, evenly spread over each split")
    rivals.add_argument("--cells", type=int, nargs="*", default=[8, 12, 16], help="of finite elements, along an edge")
    rivals.add_argument("--nonlinear-cells", type=int, nargs="*", default=[], help="of neo-Hookean ones: far slower")
    rivals.add_argument(
        "--also", type=Path, action="append", default=[], metavar="DIR",
        help="a row for another data set, none of whose bodies was trained on: scanned meshes; may be given again",
    )  # fmt: skip
    rivals.add_argument(
        "--held-out",
        type=Path,
        action="append",
        default=[],
        metavar="RUN",
        help="a row for what another run was kept from, as answered by that run; may be given again",
    )
    parser.set_defaults(run=_evaluate)


def _evaluate(options: argparse.Namespace) -> int:
    from training.data.store import StoreError
    from training.evaluate import evaluate

    try:
        if options.out:
            import training.comparison_pictures  # noqa: F401 what it lacks is better known before all is measured
        threshold, figures = evaluate(options.run_folder / "checkpoint.pt", options.data, options.split)
        found = {"threshold": threshold, **figures}
        print(json.dumps(found, indent=1))
        if options.out:
            _report(options, found)
    except (StoreError, FileNotFoundError, ModuleNotFoundError, TypeError, ValueError) as error:
        print(f"physnet-train: {error}", file=sys.stderr)
        return 1
    return 0


def _report(options: argparse.Namespace, found: dict[str, Any]) -> None:
    """Write the folder of the report, whole or not at all."""
    figures = "".join(
        f"| {key} | {f'{value:.4f}' if isinstance(value, float) else value} |\n" for key, value in found.items()
    )
    text = f"# {options.run_folder.name} on {options.data.name}\n\n| all samples | |\n|---|---|\n{figures}"
    pictures: dict[str, bytes] = {}
    if "samples_moved" in found:
        compared, tables, pictures = _beside_rivals(options, found)
        found, text = {**found, "comparison": compared}, f"{text}\n{tables}"
        print(f"\n{tables}", end="")
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "evaluation.json").write_text(json.dumps(found, indent=1) + "\n")
    (options.out / "evaluation.md").write_text(text)
    for name, picture in pictures.items():
        (options.out / name).write_bytes(picture)


def _beside_rivals(
    options: argparse.Namespace, figures: dict[str, Any]
) -> tuple[dict[str, Any], str, dict[str, bytes]]:
    """What was found of a deformation network, served as its figures say, and of its rivals; the pictures by name."""
    import torch

    from training.comparison import compare, contenders, deforming, markdown, report
    from training.comparison_pictures import curves, frontier, worst
    from training.comparison_splits import CELLS, held_out, other_bodies, splits_markdown
    from training.data.batches import DeformationSet, spread_rows
    from training.evaluate import as_tuned
    from training.networks.checkpoint import load_network

    torch.set_num_threads(1)  # as many as a finite element solve here has
    validation = DeformationSet.load(options.data, "validation")
    network = as_tuned(deforming(load_network(options.run_folder / "checkpoint.pt")[0]), figures)
    training = DeformationSet.load(options.data, "train", prior=False)
    samples = DeformationSet.load(options.data, options.split)
    rivals = contenders(network, figures["threshold"], training, options.cells, options.nonlinear_cells)
    few = contenders(network, figures["threshold"], training, CELLS)
    splits = [
        *(other_bodies(data, few, options.samples) for data in options.also),
        *(held_out(run, rivals[-1], training, validation, samples, options.samples) for run in options.held_out),
    ]
    rows = spread_rows(len(samples), options.samples)
    found = report(compare(rivals, samples, rows), samples, rows)
    text = markdown(found)
    if splits:
        found["splits"] = [split.figures() for split in splits]
        text += "\n" + splits_markdown(found["splits"])
    pictures = {
        "curves.svg": curves(found), "frontier.svg": frontier(found), "worst.png": worst(found, rivals[-1], samples),
    }  # fmt: skip
    return found, text, pictures
