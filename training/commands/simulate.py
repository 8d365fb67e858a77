"""`physnet-train simulate`: draw a data set by name."""

from __future__ import annotations

import argparse
import math
import os
import sys
from pathlib import Path


def add_simulate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    from training.data.catalogue import SETS
    from training.data.generate import ENGINES

    listing = "\n".join(f"  {name:15} {data_set.groups:5} groups: {data_set.about}" for name, data_set in SETS.items())
    parser = commands.add_parser(
        "simulate",
        help="draw a data set; what is already there is kept",
        description=f"Draw a data set:\n\n{listing}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("set", choices=SETS, metavar="SET", help="name of a data set")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--groups", type=int, help="bodies to draw; all of the set if not given")
    size.add_argument("--fraction", type=float, help="part of the whole set to draw, in (0, 1]")
    parser.add_argument("--out", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--seed", type=int, default=0, help="of random sets; the paper's grids have none")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes of one thread each")
    parser.add_argument("--engine", choices=ENGINES, default=ENGINES[0], help="processes here, or a Ray cluster")
    parser.add_argument("--resume", action="store_true", help="go on with what is there, which is done anyway")
    parser.set_defaults(run=_simulate)


def _simulate(options: argparse.Namespace) -> int:
    from training.data.catalogue import SETS
    from training.data.generate import fill
    from training.data.store import Store, StoreError

    data_set = SETS[options.set].with_seed(options.seed)
    groups = data_set.groups if options.groups is None else options.groups
    if options.fraction is not None:
        if not 0.0 < options.fraction <= 1.0:
            print("physnet-train: --fraction is a part of the set, in (0, 1]", file=sys.stderr)
            return 2
        groups = math.ceil(options.fraction * data_set.groups - 1e-9)
    if groups < 1 or options.workers < 1:
        print("physnet-train: --groups and --workers are at least 1", file=sys.stderr)
        return 2
    if data_set.is_grid and groups > data_set.groups:
        print(f"physnet-train: {options.set} has {data_set.groups} groups in all", file=sys.stderr)
        return 2
    try:
        manifest = fill(
            Store(options.out), data_set.draw, range(groups), options.workers,
            data_set.configuration(options.set, groups), options.engine,
        )  # fmt: skip
    except StoreError as error:
        print(f"physnet-train: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; the same command goes on with what is there", file=sys.stderr)
        return 130
    print(
        f"{manifest['samples']} samples in {manifest['groups']} groups, dropped {manifest['dropped']}", file=sys.stderr
    )
    return 0
