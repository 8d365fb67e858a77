"""The authors' released bridge: can a model beat interpolation between the samples it was trained on?

280 samples of one body under one force, over a grid of 20 × 20 values of Young's modulus and Poisson's ratio. Two kinds
of split: 84 samples at random, and the softest 30 %, which asks for extrapolation. Ours is the product's idea at the
size of this problem: a solve (`released_bridge`: a plane frame whose few unknowns are found from the training samples)
and a correction learnt from them (`released_correction`: kriging between samples whose solves are alike). How much of
either is chosen by validation within the training samples.

    python -m training.experiments.released_data ../shared/data/physnet_2018/train.tfrecord --out runs/released
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Int

from training.baselines import NearestNeighbours, mean_shape
from training.data.physnet_2018 import HELD_OUT, PhysNet2018, Split, grids, random_split, soft_split
from training.experiments.released_bridge import SWEEPS, Labels
from training.experiments.released_correction import Kind, mean_iou, train_ours
from training.experiments.released_network import BridgeConfig, predict, reach, train_bridge

THRESHOLDS = (0.3, 0.4, 0.5, 0.6)
SCALES = (1.0, 2.0, 4.0, 8.0)
"""Candidates for how much more Young's modulus counts than Poisson's ratio in the distance between neighbours."""


def best_scale(release: PhysNet2018, label: Labels, train: Int[np.ndarray, " train"]) -> float:
    """How much more the modulus counts, by leaving out fifths of the training samples: a fair rival is tuned."""
    truth = grids(release.deformed[train])
    scores = []
    for scale in SCALES:
        parts = []
        for fold in range(5):
            left = np.arange(len(train)) % 5 == fold
            known = train[~left]
            rival = NearestNeighbours(label[known], release.deformed[known], np.array([scale, 1.0]))
            parts.append(mean_iou(rival(label[train[left]]) > 0.5, truth[left]))
        scores.append(float(np.mean(parts)))
    return SCALES[int(np.argmax(scores))]


def rivals(release: PhysNet2018, split: Split) -> dict[str, float]:
    """Mean IoU on the held-out samples of what a model must beat."""
    train, test = split
    label = labels(release)
    truth, rest = grids(release.deformed[test]), grids(release.rest[:1])
    figures = {"nothing moves": mean_iou(np.repeat(rest, len(test), axis=0), truth)}
    mean = mean_shape(release.deformed[train])
    figures["training mean"] = max(
        mean_iou(np.repeat((mean > cut)[None], len(test), axis=0), truth) for cut in THRESHOLDS
    )
    tuned = np.array([best_scale(release, label, train), 1.0])
    for name, scale, count in (
        ("nearest neighbour", np.ones(2), 1),
        ("4-NN", np.ones(2), 4),
        ("4-NN, the modulus counting as tuned on the training samples", tuned, 4),
    ):
        rival = NearestNeighbours(label[train], release.deformed[train], scale, count)
        figures[name] = mean_iou(rival(label[test]) > 0.5, truth)
    return figures


def network(release: PhysNet2018, split: Split, kind: Kind, steps: int) -> float:
    """Mean IoU of the paper's kind of network, which knows no physics; see `released_network`."""
    train, test = split
    label, rest, known = labels(release), grids(release.rest[:1]), grids(release.deformed[train])
    config = BridgeConfig(steps=steps) if kind == "random" else BridgeConfig(steps=steps // 2, roughness=0.01)
    box = (slice(None), *reach(np.concatenate([known, rest])))
    answer = np.zeros((len(test), 64, 64, 64), np.float32)
    answer[box] = predict([train_bridge(config, label[train], known[box], rest[box][0], 0)], label[test])
    return mean_iou(answer > 0.5, grids(release.deformed[test]))


def compare(
    release: PhysNet2018, split: Split, kind: Kind, network_steps: int = 0, sweeps: int = SWEEPS
) -> tuple[dict[str, float], dict[str, object]]:
    """Mean IoU on the held-out samples by row of the table, and what was found from the training samples."""
    train, test = split
    label, truth = labels(release), grids(release.deformed[test])
    known, rest = grids(release.deformed[train]), grids(release.rest[:1])[0]
    figures = rivals(release, split)
    if network_steps:
        figures["the paper's kind of network"] = network(release, split, kind, network_steps)
    ours = train_ours(kind, label[train], known, rest, sweeps=sweeps)
    figures["our solve alone"] = mean_iou(ours.solve(label[test]) > 0.5, truth)
    figures["ours"] = mean_iou(ours(label[test], label[train], known) > 0.5, truth)
    model = ours.solve.model
    found = {"geometry": model.geometry._asdict(), "load": model.load.tolist(), "recipe": asdict(ours.recipe)}
    return figures, found


def labels(release: PhysNet2018) -> Labels:
    """Young's modulus and Poisson's ratio, both as labelled, in [0, 1]."""
    return np.ascontiguousarray(release.label[:, 1:3])


def markdown(columns: Mapping[str, Mapping[str, float]]) -> str:
    """The table: a row an answer, a column a split."""
    rows = list(next(iter(columns.values())))
    lines = ["| answer | " + " | ".join(columns) + " |", "|---" * (len(columns) + 1) + "|"]
    lines += [f"| {row} | " + " | ".join(f"{column[row]:.4f}" for column in columns.values()) + " |" for row in rows]
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None) -> int:
    """Print the table of both kinds of split, and write it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("release", type=Path, help="train.tfrecord of the authors")
    parser.add_argument("--out", type=Path, help="folder for released_data.md and released_data.json")
    parser.add_argument("--seeds", type=int, default=5, help="random splits")
    parser.add_argument("--network-steps", type=int, default=0, help="train the paper's kind of network, too: 800, say")
    parser.add_argument("--sweeps", type=int, default=SWEEPS, help="rounds of the search for the frame")
    parser.add_argument("--split", choices=["random", "soft", "both"], default="both")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    release = PhysNet2018.load(options.release)
    plans: dict[str, tuple[Kind, Split]] = {}
    if options.split != "random":
        plans["softest 30 %"] = "soft", soft_split(release.label[:, 1])
    if options.split != "soft":
        plans |= {f"random, seed {seed}": ("random", random_split(len(release), seed)) for seed in range(options.seeds)}
    columns: dict[str, dict[str, float]] = {}
    found = {}
    for name, (kind, split) in plans.items():
        columns[name], found[name] = compare(release, split, kind, options.network_steps, options.sweeps)
        print(f"{name}: " + ", ".join(f"{row} {value:.4f}" for row, value in columns[name].items()), flush=True)
    chance = [columns[name] for name, (kind, _) in plans.items() if kind == "random"]
    if chance:
        columns["random, mean"] = {row: float(np.mean([column[row] for column in chance])) for row in chance[0]}
    table = markdown(columns)
    print(table, end="", flush=True)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        (options.out / "released_data.md").write_text(table)
        record = {"held_out": HELD_OUT, "iou": columns, "found": found}
        (options.out / "released_data.json").write_text(json.dumps(record, indent=2) + "\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
