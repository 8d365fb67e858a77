"""`physnet-train dataset`: look into a data set, or import the authors' released one."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path


def add_dataset(commands: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = commands.add_parser("dataset", help="look into a data set, or import one")
    verbs = parser.add_subparsers(dest="verb", required=True)

    inspect = verbs.add_parser("inspect", help="counts, distributions, a check of the digest, pictures of samples")
    inspect.add_argument("folder", type=Path, help="folder of the data set")
    inspect.add_argument("--picture", type=Path, help="contact sheet, a PNG; FOLDER/contact-sheet.png if not given")
    inspect.add_argument("--samples", type=int, default=24, help="pictured samples")
    inspect.add_argument("--seed", type=int, default=0, help="which samples are pictured")
    inspect.set_defaults(run=_inspect)

    release = verbs.add_parser("import-2018", help="put the authors' released TFRecord file into a folder")
    release.add_argument("file", type=Path, help="train.tfrecord")
    release.add_argument("--out", type=Path, required=True, help="folder of the data set")
    release.set_defaults(run=_import)

    recgan = verbs.add_parser("import-recgan", help="put 3D-RecGAN's text files of voxels into a folder of views")
    recgan.add_argument("seen", type=Path, help="folder of 2.5D grids, such as train_25d")
    recgan.add_argument("full", type=Path, help="folder of 3D grids, such as train_3d")
    recgan.add_argument("--out", type=Path, required=True, help="folder of the data set")
    recgan.set_defaults(run=_import_recgan)


def _inspect(options: argparse.Namespace) -> int:
    from training.data.contact_sheet import contact_sheet
    from training.data.inspection import describe
    from training.data.store import Store, StoreError

    store = Store(options.folder)
    try:
        description = describe(store)
        picture = options.picture or options.folder / "contact-sheet.png"
        sheet = contact_sheet(store, options.samples, options.seed)
    except StoreError as error:
        print(f"physnet-train: {error}", file=sys.stderr)
        return 1
    picture.parent.mkdir(parents=True, exist_ok=True)
    picture.write_bytes(sheet)
    for line in description.lines():
        print(line)
    print(f"pictures            {picture}")
    return 0 if description.is_intact else 1


def _import(options: argparse.Namespace) -> int:
    from training.data.physnet_2018 import PhysNet2018
    from training.data.store import Store, StoreError

    try:
        release = PhysNet2018.load(options.file)
        release.write(Store(options.out))
    except FileNotFoundError:
        print(f"physnet-train: there is no file {options.file}", file=sys.stderr)
        return 1
    except StoreError as error:
        print(f"physnet-train: {error}", file=sys.stderr)
        return 1
    print(f"{len(release)} samples", file=sys.stderr)
    return 0


def _import_recgan(options: argparse.Namespace) -> int:
    from training.data.recgan import RecGanViews
    from training.data.store import Store, StoreError

    try:
        views = RecGanViews.find(options.seen, options.full)
        views.write(Store(options.out))
    except StoreError as error:
        print(f"physnet-train: {error}", file=sys.stderr)
        return 1
    print(f"{len(views)} views of {len(views.objects)} objects", file=sys.stderr)
    return 0
