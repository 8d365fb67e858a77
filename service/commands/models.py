"""`physnet models`: what answers, checked against its manifests."""

from __future__ import annotations

import argparse
import json

from service.commands.exits import EPILOG, OK
from service.commands.options import models_options, output_options, settings_of
from service.commands.terminal import Terminal


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
        figures = {name: value for name, value in manifest.evaluation.items() if isinstance(value, float | int)}
        if figures:
            best = ", ".join(f"{name} {value:.3g}" for name, value in list(figures.items())[:5])
            terminal.print(f"  figures    {best} (card: {folder / 'CARD.md'})")
    return OK
