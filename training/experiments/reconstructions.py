"""Exported reconstruction networks side by side on the very same views, by kind of body, visible and hidden apart.

The views are those of a `views` set's split, or noisy ones drawn of meshes, which no network was trained on:

    python -m training.experiments.reconstructions MODEL OTHER --views data/views
    python -m training.experiments.reconstructions MODEL --meshes ../shared/data/real/meshes

or bodies under one circumstance after the other, see `training.experiments.conditions`:

    python -m training.experiments.reconstructions MODEL --conditions 100
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnxruntime

from service.core.arrays import Occupancy, Probability
from service.core.covering import cover
from service.core.grids import unpack_bits
from service.core.manifest import Manifest
from training.data.batches import split_of, spread_rows
from training.data.frames import draw_view
from training.data.store import Store
from training.data.views_config import HOLLOW, ViewsConfig
from training.experiments.conditions import CIRCUMSTANCES, views_under
from training.metrics import iou, visible_and_occluded_iou
from training.simulation.grid_body import sampled, scaled
from training.simulation.mesh import MeshError, mesh_shape

MESH_SIZES_M = (0.03, 0.5)
"""Meshes with a longest edge beyond these are in a unit of their own and drawn at the size of a toy."""
TOY_M = 0.2


@dataclass(frozen=True)
class View:
    """What one frame showed of a body, and the body.

    Attributes:
        kinds: Names of the rows of the table that it counts in.
    """

    kinds: tuple[str, ...]
    observed: Occupancy
    free: Occupancy
    truth: Occupancy


class Served:
    """An exported network as the service runs it, on one thread."""

    def __init__(self, folder: Path) -> None:
        self.manifest = Manifest.from_json(json.loads((folder / "manifest.json").read_text()))
        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = 1
        path = str(folder / self.manifest.graph)
        self._session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
        self.times_ms: list[float] = []

    def __call__(self, view: View) -> Probability:
        states = np.stack([view.observed, view.free]).astype(np.float32)[None]
        started = time.perf_counter()
        (probability,) = self._session.run(["probability"], {"view": states})
        self.times_ms.append((time.perf_counter() - started) * 1e3)
        result: Probability = np.where(view.free, np.float32(0), probability[0])
        return result


def views_of_set(root: Path, split: str, most: int | None = None) -> Iterator[View]:
    """Views of a split, an even part of it if there are more than asked for."""
    groups = [(index, group) for index, group in Store(root).groups() if split in ("all", split_of(index))]
    places = [(index, group, row) for index, group in groups for row in range(len(group["sample"]))]
    chosen = spread_rows(len(places), min(most or len(places), len(places)))
    for _, group, row in (places[i] for i in chosen):
        family = str(group["family"])
        kinds = ["all", "thin" if group.get("thin", False) else "solid", family]
        kinds += ["hollow"] if family in HOLLOW else []
        kinds += ["lying or inverted"] if group.get("pose", 0) else []
        observed, free, truth = (unpack_bits(group[key][row]) for key in ("observed", "free", "truth"))
        yield View(tuple(kinds), observed, free, truth)


def views_of_meshes(folder: Path, views: int, seed: int = 0) -> Iterator[View]:
    """Noisy views of every watertight mesh of a folder, upright as the file has it."""
    for number, path in enumerate(sorted(folder.glob("*.obj"))):
        try:
            body = sampled(mesh_shape(path))
        except MeshError as error:
            print(f"{path.name}: {error}", file=sys.stderr)
            continue
        longest = float((body.bounds[:, 1] - body.bounds[:, 0]).max())
        if not MESH_SIZES_M[0] <= longest <= MESH_SIZES_M[1]:
            body = scaled(body, TOY_M / longest)
        for view in range(views):
            found = draw_view(body, ViewsConfig(), np.random.default_rng((seed, number, view)))
            if found is not None:
                yield View(("all", path.stem), found[0].observed, found[0].free, found[1])


def views_of_conditions(bodies: int) -> Iterator[View]:
    """Bodies of all families in turn, each under every circumstance."""
    for circumstance, view, truth in views_under(CIRCUMSTANCES, bodies):
        yield View((circumstance.name,), view.observed, view.free, truth)


def compare(models: Sequence[Served], views: Iterator[View]) -> dict[str, list[list[float]]]:
    """For every kind and model: views, IoU, its 10th percentile, IoU where the surface was seen and where it was not.

    A voxel counts as filled as it does in the service: above the model's own threshold, or measured where the
    reconstruction has nothing near.
    """
    scores: dict[str, list[list[tuple[float, float, float]]]] = {}
    for view in views:
        for place, model in enumerate(models):
            filled = cover(model(view) > model.manifest.threshold, view.observed)
            row = (iou(filled, view.truth), *visible_and_occluded_iou(filled, view.truth, view.observed))
            for kind in view.kinds:
                scores.setdefault(kind, [[] for _ in models])[place].append(row)
    figures: dict[str, list[list[float]]] = {}
    for kind, columns in scores.items():
        figures[kind] = []
        for rows in columns:
            whole, visible, hidden = (float(value) for value in np.mean(rows, axis=0))
            figures[kind].append([float(len(rows)), whole, float(np.quantile(rows, 0.1, axis=0)[0]), visible, hidden])
    return figures


def table(models: Sequence[Served], figures: dict[str, list[list[float]]]) -> str:
    """Markdown: kinds with the most views first."""
    names = [f"{model.manifest.name} {model.manifest.version} ({model.manifest.run})" for model in models]
    lines = ["| | views | " + " | ".join(f"{name}: IoU, p10, visible, hidden" for name in names) + " |"]
    lines.append("|---" * (2 + len(names)) + "|")
    for kind, columns in sorted(figures.items(), key=lambda item: (-item[1][0][0], item[0])):
        cells = [", ".join(f"{value:.3f}" for value in column[1:]) for column in columns]
        lines.append(f"| {kind} | {int(columns[0][0])} | " + " | ".join(cells) + " |")
    times = [f"{np.median(model.times_ms):.1f} ms" for model in models]
    lines.append("| median time on one thread | | " + " | ".join(times) + " |")
    return "\n".join(lines)


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("models", type=Path, nargs="+", help="folders of exported models")
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--views", type=Path, help="a `views` set")
    source.add_argument("--meshes", type=Path, help="a folder of OBJ files, z up, in metres")
    source.add_argument("--conditions", type=int, metavar="BODIES", help="noise and viewpoints, for that many bodies")
    parser.add_argument("--split", default="test")
    parser.add_argument("--most", type=int, help="an even part of the split")
    parser.add_argument("--each", type=int, default=12, help="views of each mesh")
    options = parser.parse_args(arguments)
    models = [Served(folder) for folder in options.models]
    if options.views:
        views = views_of_set(options.views, options.split, options.most)
    elif options.conditions:
        views = views_of_conditions(options.conditions)
    else:
        views = views_of_meshes(options.meshes, options.each)
    print(table(models, compare(models, views)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
