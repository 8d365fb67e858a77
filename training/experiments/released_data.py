"""The authors' released bridge: can a model beat interpolation between the samples it was trained on?

280 samples of one body under one force, over a grid of 20 × 20 values of Young's modulus and Poisson's ratio. With one
body E has nothing to tell and z nothing to hold: of the conditional VAE what remains is G, from the condition to a
motion that warps a learned canonical body, and a residual that the motion cannot explain (the release loses 3 to 12 %
of the voxels when it voxelises). Two splits: 84 samples at random, and the softest 30 %, which asks for extrapolation.

    python -m training.experiments.released_data ../shared/data/physnet_2018/train.tfrecord
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32, Int
from torch import Tensor, nn
from torch.nn import functional

from training.baselines import NearestNeighbours, mean_shape
from training.configs import OptimizerConfig
from training.data.physnet_2018 import PhysNet2018
from training.fit_loop import Learner
from training.losses import modified_bce_with_logits
from training.metrics import iou

HELD_OUT = 84
THRESHOLDS = (0.3, 0.4, 0.5, 0.6)
SCALES = (1.0, 2.0, 4.0, 8.0)
"""Candidates for how much more Young's modulus counts than Poisson's ratio in the distance between neighbours."""

FIELD_RATE, BODY_RATE = 3.0, 10.0
"""How much faster than the layers the fields and the canonical body learn: Adam moves each number by about its rate."""

Split: TypeAlias = tuple[Int[np.ndarray, " train"], Int[np.ndarray, " test"]]


@dataclass(frozen=True)
class BridgeConfig:
    """Of one network.

    Attributes:
        motions: Fields whose weighted sum is the displacement, each on half of the voxels of the crop.
        residuals: Grids whose weighted sum is added to the warped body's logits.
        roughness: Weight of the motions' squared second differences.
    """

    motions: int = 12
    residuals: int = 64
    hidden: int = 128
    steps: int = 800
    batch: int = 16
    roughness: float = 0.0
    optimizer: OptimizerConfig = field(
        default_factory=lambda: OptimizerConfig(learning_rate=3e-3, warm_up=80, weight_decay=0.0, betas=(0.9, 0.999))
    )


class BridgeGenerator(nn.Module):
    """G for one body: condition to motion and residual, within the box that the body ever reaches."""

    def __init__(self, config: BridgeConfig, rest: Bool[np.ndarray, "x y z"]) -> None:
        super().__init__()
        self.size = rest.shape
        x, y, z = self.size
        self.motions = config.motions
        self.embed = nn.Sequential(
            nn.Linear(6, config.hidden), nn.SiLU(), nn.Linear(config.hidden, config.hidden), nn.SiLU(),
            nn.Linear(config.hidden, config.motions + config.residuals),
        )  # fmt: skip
        self.motion = nn.Parameter(torch.randn(config.motions, 3, x // 2, y // 4, z // 2) / (100 * FIELD_RATE))
        self.residual = nn.Parameter(torch.randn(config.residuals, x * y * z) / (100 * FIELD_RATE))
        self.canonical = nn.Parameter((6.0 * torch.from_numpy(rest).float() - 3.0) / BODY_RATE)
        self.places: Tensor
        grid = torch.meshgrid(*[torch.arange(n, dtype=torch.float32) for n in self.size], indexing="ij")
        self.register_buffer("places", torch.stack(grid))

    def forward(self, label: Float[Tensor, "batch 2"]) -> Float[Tensor, "batch x y z"]:
        """Logits of the deformed body for (Young's modulus, Poisson's ratio), both as labelled, in [0, 1]."""
        weight = self.embed(features(label))
        motion = torch.einsum("bk,kcxyz->bcxyz", weight[:, : self.motions], FIELD_RATE * self.motion)
        motion = functional.interpolate(motion, size=self.size, mode="trilinear", align_corners=True)
        last = torch.tensor(self.size, dtype=torch.float32)[:, None, None, None] - 1
        source = (2.0 * (self.places - motion) / last - 1.0).permute(0, 2, 3, 4, 1).flip(-1)
        body = BODY_RATE * self.canonical[None, None].expand(len(label), -1, -1, -1, -1)
        warped = functional.grid_sample(body, source, padding_mode="border", align_corners=True)[:, 0]
        logits: Tensor = warped + (weight[:, self.motions :] @ (FIELD_RATE * self.residual)).reshape(-1, *self.size)
        return logits

    def roughness(self) -> Tensor:
        """Mean squared second difference of the motions along the bridge and upwards."""
        along, up = (((FIELD_RATE * self.motion).diff(n=2, dim=axis) ** 2).mean() for axis in (2, 4))
        return along + up


def features(label: Float[Tensor, "batch 2"]) -> Float[Tensor, "batch 6"]:
    """The labels, and what makes steep ends gentle: soft bodies move most, incompressible ones change fastest."""
    stiffness, poisson = label[:, 0], label[:, 1]
    return torch.stack(
        [
            2 * stiffness - 1, torch.log(stiffness + 0.1) + 1, 2 * torch.exp(-6 * stiffness) - 0.5,
            2 * poisson - 1, torch.log(1.05 - poisson) + 1, poisson**8,
        ],
        dim=1,
    )  # fmt: skip


def train_bridge(
    config: BridgeConfig, label: Float32[np.ndarray, "n 2"], deformed: Bool[np.ndarray, "n x y z"],
    rest: Bool[np.ndarray, "x y z"], seed: int,
) -> BridgeGenerator:  # fmt: skip
    """Fit the network to the samples."""
    torch.manual_seed(seed)
    network = BridgeGenerator(config, rest)
    learner = Learner(network, config.optimizer, config.steps)
    truth, condition = torch.from_numpy(deformed).float(), torch.from_numpy(label)
    for step in range(config.steps):
        rows = np.random.default_rng((seed, step)).choice(len(label), min(config.batch, len(label)), replace=False)
        loss = modified_bce_with_logits(network(condition[rows]), truth[rows], alpha=0.5)
        learner.learn(loss + config.roughness * network.roughness())
    return network.eval()


@torch.no_grad()
def predict(
    networks: list[BridgeGenerator], label: Float32[np.ndarray, "n 2"]
) -> Float32[np.ndarray, "n x y z"]:
    """Mean probability over the networks."""
    answers = [
        torch.stack([network(part).sigmoid() for network in networks]).mean(dim=0)
        for part in torch.from_numpy(label).split(16)
    ]
    return torch.cat(answers).numpy()


def random_split(count: int, seed: int) -> Split:
    """84 held out at random."""
    order = np.random.default_rng(seed).permutation(count)
    return np.sort(order[HELD_OUT:]), np.sort(order[:HELD_OUT])


def soft_split(stiffness: Float32[np.ndarray, " n"]) -> Split:
    """The softest 30 % held out: nothing trained on moves as far."""
    order = np.argsort(stiffness, kind="stable")
    return np.sort(order[HELD_OUT:]), np.sort(order[:HELD_OUT])


def mean_iou(answer: Bool[np.ndarray, "n x y z"], truth: Bool[np.ndarray, "n x y z"]) -> float:
    """Mean over the samples."""
    return float(np.mean([iou(a, t) for a, t in zip(answer, truth, strict=True)]))


def best_scale(release: PhysNet2018, label: Float32[np.ndarray, "n 2"], train: Int[np.ndarray, " train"]) -> float:
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


def grids(bits: np.ndarray) -> Bool[np.ndarray, "n x y z"]:
    """Packed grids as voxels."""
    return np.unpackbits(bits, axis=1, bitorder="little").reshape(-1, 64, 64, 64) > 0


def reach(voxels: Bool[np.ndarray, "n x y z"]) -> tuple[slice, slice, slice]:
    """The box of all voxels that are ever filled, with one around it."""
    where = np.argwhere(voxels.any(axis=0))
    low, high = np.maximum(where.min(axis=0) - 1, 0), np.minimum(where.max(axis=0) + 2, 64)
    x, y, z = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    return x, y, z


def compare(release: PhysNet2018, split: Split, config: BridgeConfig, seeds: int) -> dict[str, float]:
    """Mean IoU on the held-out samples, of the baselines and of ours."""
    train, test = split
    label = np.ascontiguousarray(release.label[:, 1:3])
    truth, rest = grids(release.deformed[test]), grids(release.rest[:1])
    scale = best_scale(release, label, train)
    figures = {
        "identity": mean_iou(np.repeat(rest, len(test), axis=0), truth),
        "training mean": max(
            mean_iou(np.repeat((mean_shape(release.deformed[train]) > cut)[None], len(test), axis=0), truth)
            for cut in THRESHOLDS
        ),
    }
    for name, weight in (("4-NN", 1.0), (f"4-NN, modulus counts {scale:.0f}-fold", scale)):
        rival = NearestNeighbours(label[train], release.deformed[train], np.array([weight, 1.0]))
        figures[name] = mean_iou(rival(label[test]) > 0.5, truth)
    known = grids(release.deformed[train])
    box = (slice(None), *reach(np.concatenate([known, rest])))
    networks = [train_bridge(config, label[train], known[box], rest[box][0], seed) for seed in range(seeds)]
    ours = np.zeros(truth.shape, np.float32)
    ours[box] = predict(networks, label[test])
    figures["ours"] = mean_iou(ours > 0.5, truth)
    interpolated = NearestNeighbours(label[train], release.deformed[train], np.array([scale, 1.0]))(label[test])
    figures["ours and 4-NN, averaged"] = mean_iou((2 * ours + interpolated) / 3 > 0.5, truth)
    return figures


def main(arguments: list[str] | None = None) -> int:
    """Print both splits."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("release", type=Path, help="train.tfrecord of the authors")
    parser.add_argument("--seeds", type=int, default=2, help="networks that are averaged")
    parser.add_argument("--steps", type=int, default=800)
    parser.add_argument("--split", choices=["random", "soft", "both"], default="both")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    release = PhysNet2018.load(options.release)
    plans = {
        "random": (random_split(len(release), seed=0), BridgeConfig(steps=options.steps)),
        "soft": (soft_split(release.label[:, 1]), BridgeConfig(steps=options.steps // 2, roughness=0.01)),
    }
    for name in plans if options.split == "both" else [options.split]:
        print(f"{name}: {HELD_OUT} of {len(release)} held out", flush=True)
        for row, value in compare(release, *plans[name], options.seeds).items():
            print(f"  {row:32s} {value:.4f}", flush=True)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
