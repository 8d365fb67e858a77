"""The cascade as served beside a single network from view to deformed shape, on bodies that neither was trained on.

    python -m benchmarks.service.cascade --bodies data/everyday --direct runs/direct [--out runs/direct]

Both answer the same noisy views under the same loads, told in newtons and metres. `training.experiments.direct` trains
the single network.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import torch

from service.core.alignment import resample
from service.core.arrays import GRID_SIZE, Probability
from service.core.errors import PhysNetError
from service.core.grids import Grid, unpack_bits
from service.core.materials import Material
from service.core.messages import DeformRequest, EncodedImage, Load, Observation
from service.inference.registry import load_models
from service.pipeline import Pipeline
from service.settings import Settings
from training.data.batches import split_of, spread_rows
from training.data.frames import Frame
from training.data.generate import Dropped
from training.data.pushed_views import PushedViewsConfig, frames, moved_condition
from training.data.store import Store
from training.evaluate import MOVED
from training.experiments.direct import REALTIME, trained
from training.metrics import iou, skill
from training.networks.direct import DirectNetwork

STILL, STILL_RECONSTRUCTED, CASCADE, DIRECT, CEILING = (
    "nothing moves, true body", "nothing moves, reconstructed body", "cascade", "direct network",
    "truth by way of the view grid",
)  # fmt: skip
ROWS = (STILL, STILL_RECONSTRUCTED, CASCADE, DIRECT, CEILING)
"""The last is the best that the view grid, in which the direct network answers, can hold."""


@dataclass(frozen=True)
class Rivals:
    """Both, and the probability above which a voxel of their answers is filled.

    Attributes:
        cascade: As served.
        cascade_threshold: Of its deformation network.
        direct: The single network.
        direct_threshold: Tuned on validation.
    """

    cascade: Pipeline
    cascade_threshold: float
    direct: DirectNetwork
    direct_threshold: float


def question(frame: Frame, group: Mapping[str, np.ndarray], row: int) -> DeformRequest:
    """What a robot would ask: the load of a row of the group in newtons, all in the camera frame."""
    pose, camera = frame.viewpoint
    condition, edge_m = group["condition"][row].astype(np.float64), float(group["edge_m"])
    load = Load(
        force_n=pose[:3, :3] @ condition[3:6] * float(group["force_n"][row]),
        contact_m=pose[:3, :3] @ (condition[:3] * edge_m) + pose[:3, 3],
        patch_radius_m=float(condition[8]) * edge_m,
    )
    if frame.hints.mask is None:
        raise ValueError("the contact may lie on the hidden side: only a mask can name the object")
    mask = cv2.imencode(".png", frame.hints.mask.astype(np.uint8) * 255)[1].tobytes()
    depth = EncodedImage("32FC1", frame.depth_m.astype("<f4").tobytes())
    source = Observation(camera, depth, EncodedImage("png8", mask), frame.hints.up)
    return DeformRequest(source, Material(float(group["young_modulus_pa"][row]), float(condition[7])), (load,))


@torch.no_grad()
def ask_direct(network: DirectNetwork, frame: Frame, group: Mapping[str, np.ndarray], row: int) -> Probability:
    """Of every voxel of the view grid after the push."""
    in_world = Grid(frame.view.grid.pitch_m, frame.world_from_grid)
    condition = moved_condition(group["condition"][row], float(group["edge_m"]), in_world)
    view = np.stack([frame.view.observed, frame.view.free]).astype(np.float32)[None]
    answer: Probability = network(torch.from_numpy(view), torch.from_numpy(condition[None])).sigmoid()[0].numpy()
    return answer


def scores(frame: Frame, group: Mapping[str, np.ndarray], row: int, rivals: Rivals) -> dict[str, list[float]]:
    """IoU of every answer of `ROWS` with the truth, in the grid of the true body and in the view grid.

    Raises:
        PhysNetError: The service refuses the question.
    """
    result = rivals.cascade.predict(question(frame, group, row))
    view = frame.view.grid
    body = Grid(float(group["edge_m"]) / GRID_SIZE, frame.viewpoint.camera_from_world)
    rest, truth = (unpack_bits(bits).astype(np.float32) for bits in (group["rest"], group["deformed"][row]))
    answers: dict[str, tuple[Probability, Grid, float]] = {
        STILL: (rest, body, 0.5),
        STILL_RECONSTRUCTED: (result.reconstruction.astype(np.float32), result.grid, 0.5),
        CASCADE: (result.loads[0].probability, result.grid, rivals.cascade_threshold),
        DIRECT: (ask_direct(rivals.direct, frame, group, row), view, rivals.direct_threshold),
        CEILING: ((_brought(truth, body, view) > 0.5).astype(np.float32), view, 0.5),
    }
    truths = [_brought(truth, body, grid) > 0.5 for grid in (body, view)]
    return {
        name: [iou(_brought(p, source, grid) > cut, t) for grid, t in zip((body, view), truths, strict=True)]
        for name, (p, source, cut) in answers.items()
    }


def _brought(probability: Probability, source: Grid, target: Grid) -> Probability:
    return probability if source is target else resample(probability, source, target)


def judge(config: PushedViewsConfig, rivals: Rivals, most: int | None = None) -> dict[str, Any]:
    """Every load on the test bodies of a set, seen in every view; an even part of the bodies if there are too many."""
    store = Store(Path(config.bodies))
    indices = sorted(int(path.stem) for path in (store.root / "groups").glob("*.npz"))
    indices = [index for index in indices if split_of(index) == "test"]
    chosen = spread_rows(len(indices), min(most or len(indices), len(indices)))
    rows: list[dict[str, Any]] = []
    refused: list[str] = []
    left_out = 0
    for index in (indices[place] for place in chosen):
        group = store.group(index)
        try:
            seen = list(frames(config, index))
        except Dropped:
            left_out += 1
            continue
        for number, frame in seen:
            for row in range(len(group["sample"])):
                about = {
                    "group": index, "view": number, "load": row, "family": str(group["family"]),
                    "identity": float(group["identity_iou"][row]),
                }  # fmt: skip
                try:
                    rows.append(about | scores(frame, group, row, rivals))
                except PhysNetError as error:
                    refused.append(f"{index}, view {number}, load {row}: {error}")
    return {"rows": rows, "refused": refused, "bodies_left_out": left_out}


def summary(found: Mapping[str, Any]) -> dict[str, Any]:
    """Means of all questions, of those whose body moves, and how far apart cascade and direct network are.

    The error is that of the mean over bodies: views and loads of one body are not independent.
    """
    rows = found["rows"]
    moved = np.array([row["identity"] < MOVED for row in rows])
    group = np.array([row["group"] for row in rows])
    still = np.array([row["identity"] for row in rows])
    values = {name: np.array([row[name] for row in rows]) for name in ROWS}
    apart = (values[CASCADE] - values[DIRECT])[:, 0]
    by_body = np.array([apart[group == index].mean() for index in np.unique(group)])
    return {
        "questions": len(rows), "moved": int(moved.sum()), "bodies": len(by_body), "refused": len(found["refused"]),
        "bodies_left_out": found["bodies_left_out"],
        "iou": {name: value.mean(axis=0).tolist() for name, value in values.items()},
        "iou_moved": {name: value[moved].mean(axis=0).tolist() for name, value in values.items()},
        "iou_p10": {name: np.quantile(value, 0.1, axis=0).tolist() for name, value in values.items()},
        "skill": {name: float(skill(value[moved, 0], still[moved]).mean()) for name, value in values.items()},
        "cascade_ahead": {
            "mean": float(by_body.mean()), "error": float(by_body.std(ddof=1) / np.sqrt(len(by_body))),
            "share_of_questions": float((apart > 0).mean()),
        },
    }  # fmt: skip


def markdown(figures: Mapping[str, Any]) -> str:
    """The summary as a table."""
    lines = [
        f"{figures['questions']} questions about {figures['bodies']} bodies, {figures['moved']} of which move; "
        f"{figures['refused']} refused, {figures['bodies_left_out']} bodies left out.", "",
        "| IoU | of all | worst tenth below | of those that move | of all, in the view grid |", "|---|---|---|---|---|",
    ]  # fmt: skip
    for name in ROWS:
        (all_body, all_view), moved = figures["iou"][name], figures["iou_moved"][name][0]
        lines.append(f"| {name} | {all_body:.3f} | {figures['iou_p10'][name][0]:.3f} | {moved:.3f} | {all_view:.3f} |")
    ahead = figures["cascade_ahead"]
    lines += ["", f"The cascade is ahead by {ahead['mean']:.3f} ± {ahead['error']:.3f} (mean and its error over "
              f"bodies), in {ahead['share_of_questions']:.0%} of the questions."]  # fmt: skip
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Judge, write cascade.json and cascade.md, print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.service.cascade", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--bodies", type=Path, required=True, help="folder of an everyday set")
    parser.add_argument("--direct", type=Path, required=True, help="folder of training.experiments.direct")
    parser.add_argument("--models", type=Path, default=Settings().models, help="of the cascade")
    parser.add_argument("--most", type=int, help="bodies; all of the test split")
    parser.add_argument("--out", type=Path, help="folder of the report; that of --direct")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    network, threshold = trained(options.direct / "run", REALTIME)
    models = load_models(options.models, 1)
    rivals = Rivals(
        Pipeline(models.reconstruction, models.deformation), models.deformation.manifest.threshold,
        network, threshold,
    )  # fmt: skip
    found = judge(PushedViewsConfig(str(options.bodies)), rivals, options.most)
    figures = summary(found) | {"direct_threshold": threshold}
    out = options.out or options.direct
    out.mkdir(parents=True, exist_ok=True)
    (out / "cascade.json").write_text(json.dumps(found | {"summary": figures}, indent=1) + "\n")
    (out / "cascade.md").write_text(markdown(figures))
    print(markdown(figures), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
