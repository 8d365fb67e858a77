"""The command line of everything that makes models.

`physnet-train simulate | dataset | solve | fit | evaluate | export`.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path

from training.commands.dataset import add_dataset
from training.commands.evaluate import add_evaluate
from training.commands.simulate import add_simulate
from training.commands.solve import add_solve


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="physnet-train", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)

    fit = commands.add_parser("fit", help="train a network, from where its run last stopped")
    fit.add_argument("network", choices=["reconstruction", "deformation"])
    fit.add_argument("--data", type=Path, required=True, help="folder of the data set")
    fit.add_argument("--run", dest="run_folder", type=Path, required=True, help="folder of the run")
    fit.add_argument("--preset", default="realtime", help="realtime, realtime-gan, paper; realtime-lattice, icgan")
    fit.add_argument("--steps", type=int, help="optimizer steps in all")
    fit.add_argument("--learning-rate", type=float)
    fit.add_argument("--seed", type=int)
    fit.add_argument(
        "--init-from", type=Path, metavar="RUN",
        help="begin with the weights of another run that fit; reconstruction: or of models/NAME/VERSION",
    )
    fit.add_argument(
        "--more", type=Path, action="append", default=[], metavar="DIR",
        help="train on this data set too; may be given again",
    )
    fit.add_argument("--threads", type=int, default=os.cpu_count() or 1)
    fit.set_defaults(run=_fit)

    export = commands.add_parser("export", help="evaluate a run and write it as an ONNX graph with manifest and card")
    export.add_argument("--run", dest="run_folder", type=Path, required=True)
    export.add_argument("--data", type=Path, required=True)
    export.add_argument("--models", type=Path, default=Path("models"), help="folder that holds all models")
    export.add_argument("--name", required=True)
    export.add_argument("--version", required=True)
    export.add_argument("--int8", action="store_true", help="in 8-bit integers if that loses next to nothing (views)")
    export.add_argument("--note", default="", help="a sentence for its card")
    export.set_defaults(run=_export)

    add_evaluate(commands)
    add_simulate(commands)
    add_dataset(commands)
    add_solve(commands)

    options = parser.parse_args(arguments)
    code: int = options.run(options)
    return code


def _fit(options: argparse.Namespace) -> int:
    import torch

    from training.configs import DEFORMATION_PRESETS, RECONSTRUCTION_PRESETS, ConfigError, chosen
    from training.data.store import StoreError
    from training.fit_deformation import fit_deformation
    from training.fit_reconstruction import fit_reconstruction
    from training.runs import Run, RunError

    torch.set_num_threads(options.threads)
    changes = {key: getattr(options, key) for key in ("steps", "learning_rate", "seed")}
    run = Run(options.run_folder)
    begin_from = _beginning(options.network, options.init_from)
    try:
        if options.network == "deformation":
            config = chosen(DEFORMATION_PRESETS, options.preset, **changes)
            fit_deformation(options.data, run, config, begin_from, options.more)
        else:
            views = chosen(RECONSTRUCTION_PRESETS, options.preset, **changes)
            fit_reconstruction(options.data, run, views, begin_from, options.more)
    except (ConfigError, RunError, StoreError, FileNotFoundError, ValueError) as error:
        print(f"physnet-train: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; the same command goes on from the last checkpoint", file=sys.stderr)
        return 130
    return 0


def _beginning(network: str, folder: Path | None) -> Path | None:
    """The checkpoint of a run, or the folder of a model that is served, which reconstruction can begin with, too."""
    if folder is None or (network == "reconstruction" and (folder / "manifest.json").exists()):
        return folder
    return folder / "checkpoint.pt"


def _export(options: argparse.Namespace) -> int:
    from training.data.batches import DeformationSet
    from training.data.store import StoreError
    from training.evaluate import evaluate
    from training.export import ExportError, condition_range_of, export_model
    from training.quantise import quantise

    checkpoint = options.run_folder / "checkpoint.pt"
    ranges: dict[str, tuple[float, float]] = {}
    try:
        threshold, figures = evaluate(checkpoint, options.data, "test")
        if "samples_moved" in figures:
            ranges = condition_range_of(DeformationSet.load(options.data, "train").condition)
        manifest = export_model(
            checkpoint, options.models, options.name, options.version, threshold, ranges, figures, options.note
        )
        if options.int8:
            manifest = quantise(options.models / options.name / options.version, options.data)
    except (ExportError, StoreError, FileNotFoundError) as error:
        print(f"physnet-train: {error}", file=sys.stderr)
        return 1
    figures = manifest.evaluation
    print(f"{manifest.name} {manifest.version}: differs from torch by {manifest.parity:.1e}; {json.dumps(figures)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
