"""`physnet models`: what answers, checked against its manifests."""

from __future__ import annotations

import argparse
import json

from service.commands.exits import EPILOG, OK
from service.commands.options import models_options, output_options, settings_of
from service.commands.terminal import Terminal

_FIGURES = (
    ("iou", "IoU {:.3f}"),
    ("iou_identity", "{:.3f} where nothing moves"),
    ("skill", "skill {:.2f}"),
    ("displacement_error", "displacement off by {:.1%} of the peak"),
    ("samples", "on {:,} samples never trained on"),
)
"""What of a manifest's evaluation people ask for first; the card has it all."""


def add_models(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = commands.add_parser(
        "models", parents=[models_options(), output_options()], help="check and list the models", epilog=EPILOG,
        description="Open the models that would answer and check each file against its digest.",
    )  # fmt: skip
    parser.set_defaults(run=_run)


def _run(given: argparse.Namespace) -> int:
    from service.inference.registry import load_models

    terminal = Terminal(given.color)
    settings = settings_of(given)
    with terminal.working("opening the models"):
        manifests = load_models(settings.models, settings.threads).manifests
    if given.json:
        terminal.print(json.dumps({"models": [manifest.to_json() for manifest in manifests]}))
        return OK
    for manifest in manifests:
        folder = settings.models / manifest.name / manifest.version
        size = sum((folder / name).stat().st_size for name in manifest.files)
        terminal.print(f"{terminal.paint(manifest.name, 'bold')} {manifest.version}: {manifest.kind}")
        terminal.print(f"  files      {len(manifest.files)} with the digests of the manifest, {size / 2**20:.1f} MiB")
        terminal.print(f"  folder     {folder}")
        terminal.print(f"  threshold  {manifest.threshold:g}")
        terminal.print(f"  trained    run {manifest.run}, exported at commit {manifest.commit[:12]}")
        found = manifest.evaluation
        if figures := [words.format(found[name]) for name, words in _FIGURES if name in found]:
            terminal.print(f"  measured   {', '.join(figures)}")
        terminal.print(f"  card       {folder / 'CARD.md'}")
    return OK
