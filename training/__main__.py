"""The command line of everything that makes models: `physnet-train simulate | fit | evaluate | export`."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import os
import sys
from pathlib import Path


def main(arguments: list[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    parser = argparse.ArgumentParser(prog="physnet-train", description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)

    simulate = commands.add_parser("simulate", help="draw a data set; what is already there is kept")
    simulate.add_argument("set", choices=["everyday", "views"])
    simulate.add_argument("--groups", type=int, required=True, help="bodies to draw")
    simulate.add_argument("--out", type=Path, required=True, help="folder of the data set")
    simulate.add_argument("--seed", type=int, default=0)
    simulate.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    simulate.set_defaults(run=_simulate)

    options = parser.parse_args(arguments)
    code: int = options.run(options)
    return code


def _simulate(options: argparse.Namespace) -> int:
    from training.data.generate import fill
    from training.data.store import Store

    if options.set == "everyday":
        from training.data.everyday import EverydayConfig, draw_group

        config = EverydayConfig(seed=options.seed)
        draw = functools.partial(draw_group, config)
        configuration = {"set": "everyday", "groups": options.groups, **dataclasses.asdict(config)}
    else:
        from training.data import views

        views_config = views.ViewsConfig(seed=options.seed)
        draw = functools.partial(views.draw_group, views_config)
        configuration = {"set": "views", "groups": options.groups, **dataclasses.asdict(views_config)}
    manifest = fill(Store(options.out), draw, range(options.groups), options.workers, configuration)
    print(f"{manifest['samples']} samples in {manifest['groups']} groups, dropped {manifest['dropped']}", file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main())
