"""`physnet-train compare`: a deformation network beside what it must beat, as a table."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path


def add_compare(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = commands.add_parser(
        "compare",
        help="put a deformation network beside no motion, known answers, finite elements and the coarse solve",
        description="Score a deformation network and its rivals one load at a time on bodies it has never seen; write "
        "comparison.md, comparison.json, curves.svg, frontier.svg and worst.png.",
    )
    parser.add_argument("--run", dest="run_folder", type=Path, required=True)
    parser.add_argument("--data", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--split", choices=["validation", "test"], default="test")
    parser.add_argument("--samples", type=int, default=200, help="evenly spread over the split")
    parser.add_argument("--cells", type=int, nargs="*", default=[8, 12, 16], help="of finite elements, along an edge")
    parser.add_argument("--nonlinear-cells", type=int, nargs="*", default=[], help="of neo-Hookean ones: far slower")
    parser.add_argument("--out", type=Path, required=True, help="folder of the report")
    parser.set_defaults(run=_compare)


def _compare(options: argparse.Namespace) -> int:
    import numpy as np
    import torch

    from training.comparison import compare, contenders, deforming, markdown, report
    from training.comparison_pictures import curves, frontier, worst
    from training.data.batches import DeformationSet
    from training.data.store import StoreError
    from training.evaluate import as_served
    from training.networks.checkpoint import load_network

    torch.set_num_threads(1)  # as many as a finite element solve here has
    try:
        network = deforming(load_network(options.run_folder / "checkpoint.pt")[0])
        network, threshold, _ = as_served(network, DeformationSet.load(options.data, "validation"))
        training = DeformationSet.load(options.data, "train", prior=False)
        samples = DeformationSet.load(options.data, options.split)
        rivals = contenders(network, threshold, training, options.cells, options.nonlinear_cells)
    except (StoreError, FileNotFoundError, TypeError) as error:
        print(f"physnet-train: {error}", file=sys.stderr)
        return 1
    rows = np.unique(np.linspace(0, len(samples) - 1, options.samples).astype(int))
    found = report(compare(rivals, samples, rows), samples, rows)
    options.out.mkdir(parents=True, exist_ok=True)
    (options.out / "comparison.json").write_text(json.dumps(found, indent=1) + "\n")
    (options.out / "comparison.md").write_text(markdown(found))
    (options.out / "curves.svg").write_bytes(curves(found))
    (options.out / "frontier.svg").write_bytes(frontier(found))
    (options.out / "worst.png").write_bytes(worst(found, rivals[-1], samples))
    print(markdown(found), end="")
    return 0
