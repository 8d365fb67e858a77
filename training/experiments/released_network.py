"""The paper's kind of network on the authors' release: from the condition alone, with no physics.

With one body E has nothing to tell and z nothing to hold: of the conditional VAE what remains is G, from the condition
to a motion that warps a learned canonical body, and a residual that the motion cannot explain (the release loses 3 to
12 % of the voxels when it voxelises).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from torch import Tensor, nn
from torch.nn import functional

from training.configs import OptimizerConfig
from training.fit_loop import Learner
from training.losses import modified_bce_with_logits

FIELD_RATE, BODY_RATE = 3.0, 10.0
"""How much faster than the layers the fields and the canonical body learn: Adam moves each number by about its rate."""


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
def predict(networks: list[BridgeGenerator], label: Float32[np.ndarray, "n 2"]) -> Float32[np.ndarray, "n x y z"]:
    """Mean probability over the networks."""
    answers = [
        torch.stack([network(part).sigmoid() for network in networks]).mean(dim=0)
        for part in torch.from_numpy(label).split(16)
    ]
    return torch.cat(answers).numpy()


def reach(voxels: Bool[np.ndarray, "n x y z"]) -> tuple[slice, slice, slice]:
    """The box of all voxels that are ever filled, with one around it."""
    where = np.argwhere(voxels.any(axis=0))
    low, high = np.maximum(where.min(axis=0) - 1, 0), np.minimum(where.max(axis=0) + 2, 64)
    x, y, z = (slice(int(a), int(b)) for a, b in zip(low, high, strict=True))
    return x, y, z
