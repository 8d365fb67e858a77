"""`physnet-train simulate`: draw a data set by name."""

from __future__ import annotations

import argparse
import dataclasses
import math
import os
import sys
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

from training.commands.grammar import UNITS_M

if TYPE_CHECKING:
    from training.data.catalogue import DataSet


def add_simulate(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    from training.data.catalogue import GROUPS_OF_MESHES, MESHES, SETS
    from training.data.generate import ENGINES

    listing = "\n".join(f"  {name:15} {data_set.groups:5} groups: {data_set.about}" for name, data_set in SETS.items())
    listing += f"\n  {MESHES:15} {GROUPS_OF_MESHES:5} groups: your own objects, from the folder --meshes"
    parser = commands.add_parser(
        "simulate",
        help="draw a data set; what is already there is kept",
        description=f"Draw a data set:\n\n{listing}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("set", choices=[*SETS, MESHES], metavar="SET", help="name of a data set")
    parser.add_argument("--meshes", type=Path, metavar="DIR", help="folder of watertight meshes of your own")
    parser.add_argument("--unit", choices=UNITS_M, default="m", help="length unit of these files")
    parser.add_argument("--up", choices=["x", "y", "z"], default="z", help="their axis that points up")
    size = parser.add_mutually_exclusive_group()
    size.add_argument("--groups", type=int, help="bodies to draw; all of the set if not given")
    size.add_argument("--fraction", type=float, help="part of the whole set to draw, in (0, 1]")
    parser.add_argument("--out", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--seed", type=int, default=0, help="of random sets; the paper's grids have none")
    parser.add_argument("--loads", type=int, help="pushes on each body, where they are drawn, instead of the set's own")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="processes of one thread each")
    parser.add_argument("--engine", choices=ENGINES, default=ENGINES[0], help="processes here, or a Ray cluster")
    parser.add_argument("--resume", action="store_true", help="go on with what is there, which is done anyway")
    parser.set_defaults(run=_simulate)


def _own_meshes(options: argparse.Namespace) -> DataSet:
    """The set of a folder; says of each mesh what is wrong with it before anything is drawn."""
    from training.data.catalogue import GROUPS_OF_MESHES, DataSet
    from training.data.meshes import meshes_in
    from training.simulation.mesh import MeshError, load_triangles

    config = meshes_in(options.meshes, UNITS_M[options.unit], options.up, options.seed)
    good = []
    for name, digest in config.files:
        try:
            with warnings.catch_warnings(record=True) as told:
                warnings.simplefilter("always")
                load_triangles(options.meshes / name, config.unit_m)
        except MeshError as error:
            print(f"physnet-train: left out: {error}", file=sys.stderr)
            continue
        for warning in told:
            print(f"physnet-train: {warning.message}", file=sys.stderr)
        good.append((name, digest))
    if not good:
        raise MeshError(f"no mesh in {options.meshes} can be used")
    config = dataclasses.replace(config, files=tuple(good))
    return DataSet(config, GROUPS_OF_MESHES, "your own objects")


def _simulate(options: argparse.Namespace) -> int:
    from training.data.catalogue import MESHES, SETS
    from training.data.generate import fill
    from training.data.store import Store, StoreError
    from training.simulation.mesh import MeshError

    if (options.set == MESHES) != (options.meshes is not None):
        print(f"physnet-train: the set {MESHES} and --meshes DIR belong together", file=sys.stderr)
        return 2
    try:
        data_set = _own_meshes(options) if options.set == MESHES else SETS[options.set].with_seed(options.seed)
    except MeshError as error:
        print(f"physnet-train: {error}", file=sys.stderr)
        return 2
    if options.loads is not None:
        try:
            data_set = data_set.with_loads(options.loads)
        except ValueError as error:
            print(f"physnet-train: {error}", file=sys.stderr)
            return 2
    groups = data_set.groups if options.groups is None else options.groups
    if options.fraction is not None:
        if not 0.0 < options.fraction <= 1.0:
            print("physnet-train: --fraction is a part of the set, in (0, 1]", file=sys.stderr)
            return 2
        groups = math.ceil(options.fraction * data_set.groups - 1e-9)
    if groups < 1 or options.workers < 1 or (options.loads is not None and options.loads < 1):
        print("physnet-train: --groups, --workers and --loads are at least 1", file=sys.stderr)
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
