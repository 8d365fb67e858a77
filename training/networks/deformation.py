"""The paper's conditional VAE generator, for a CPU: a shape is encoded once, every load decodes a displacement field.

The field is the backward displacement: at a place y of the deformed body it tells how far the material now there has
come, so the material's place at rest is y - u(y) and the deformed occupancy is the undeformed one looked up there.
Detail of the shape thus passes through unblurred, and the field can be coarse.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from service.core import lookup
from training.networks.blocks import (
    LEAKY_SLOPE,
    ConvBlock,
    ModulatedResidualBlock,
    ResidualBlock,
    Upsample,
    cell_centres,
    depth_to_space,
    space_to_depth,
)
from training.networks.conditions import PLANES, SERVED_CENTRE, SERVED_SCALE, condition_planes

BLOCK = 4
FIELD_SIZE = 32
"""The displacement field is decoded on 32³ nodes and interpolated to 64³ voxels."""

CLAMP_HEIGHT = 4.0 / 64.0
"""The body is clamped on the floor: the field is scaled by tanh(z / this), in edges of the grid."""

CONDITION_SIZE = 9


@dataclass(frozen=True)
class DeformationConfig:
    """Channels at 16³, 8³ and 4³ of the encoder and of the generator, sizes of the latent and of the condition."""

    encoder_channels: tuple[int, int, int] = (48, 96, 160)
    generator_channels: tuple[int, int, int] = (32, 64, 128)
    generator_blocks: tuple[int, int, int] = (1, 2, 3)
    latent: int = 16
    condition: int = 64
    log_gain: float = 0.0
    """Mean over the training set of log10(peak displacement / load number): where the gain starts."""


class ShapeEncoder(nn.Module):
    """E: features of the undeformed body at 16³, 8³ and 4³, and the latent's μ and log σ²."""

    def __init__(self, config: DeformationConfig) -> None:
        super().__init__()
        fine, middle, coarse = config.encoder_channels
        self.fine = nn.Sequential(ConvBlock(BLOCK**3, fine, 1), ResidualBlock(fine))
        self.middle = nn.Sequential(ConvBlock(fine, middle, 2, 2), ResidualBlock(middle))
        self.coarse = nn.Sequential(ConvBlock(middle, coarse, 2, 2), ResidualBlock(coarse), ResidualBlock(coarse))
        self.latent = nn.Linear(coarse, 2 * config.latent)

    def forward(self, rest: Float[Tensor, "batch 1 64 64 64"]) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor]:
        fine = self.fine(space_to_depth(rest, BLOCK))
        middle = self.middle(fine)
        coarse = self.coarse(middle)
        mean, log_variance = self.latent(coarse.mean(dim=(2, 3, 4))).chunk(2, dim=1)
        return fine, middle, coarse, mean, log_variance


class LoadGenerator(nn.Module):
    """G: latent, condition and the encoder's skips to a displacement field for one load."""

    def __init__(self, config: DeformationConfig) -> None:
        super().__init__()
        self.config = config
        fine_in, middle_in, coarse_in = config.encoder_channels
        fine, middle, coarse = config.generator_channels
        fine_blocks, middle_blocks, coarse_blocks = config.generator_blocks
        hidden = config.condition
        self.embed = nn.Sequential(
            nn.Linear(CONDITION_SIZE + config.latent, hidden), nn.LeakyReLU(LEAKY_SLOPE),
            nn.Linear(hidden, hidden), nn.LeakyReLU(LEAKY_SLOPE),
        )  # fmt: skip
        self.enter_coarse = ConvBlock(coarse_in + PLANES, coarse, 1)
        self.coarse = nn.ModuleList(ModulatedResidualBlock(coarse, hidden) for _ in range(coarse_blocks))
        self.up_middle = Upsample(coarse, middle)
        self.enter_middle = ConvBlock(middle + middle_in + PLANES, middle, 1)
        self.middle = nn.ModuleList(ModulatedResidualBlock(middle, hidden) for _ in range(middle_blocks))
        self.up_fine = Upsample(middle, fine)
        self.enter_fine = ConvBlock(fine + fine_in + PLANES, fine, 1)
        self.fine = nn.ModuleList(ModulatedResidualBlock(fine, hidden) for _ in range(fine_blocks))
        self.head = nn.Conv3d(fine, 3 * (FIELD_SIZE // 16) ** 3, 1)
        self.gain = nn.Sequential(nn.Linear(coarse + hidden, hidden), nn.LeakyReLU(LEAKY_SLOPE), nn.Linear(hidden, 1))

    def forward(
        self, fine_skip: Tensor, middle_skip: Tensor, coarse_skip: Tensor, z: Tensor, condition: Tensor
    ) -> Float[Tensor, "batch 3 32 32 32"]:
        h = self.embed(torch.cat([_normalised(condition), z], dim=1))
        x = self.enter_coarse(torch.cat([coarse_skip, condition_planes(condition, 4)], dim=1))
        for block in self.coarse:
            x = block(x, h)
        # Displacement grows with the load number before it saturates, over decades: the network predicts the log of
        # the gain, and the field around it stays of order one.
        log_gain = self.config.log_gain + self.gain(torch.cat([x.mean(dim=(2, 3, 4)), h], dim=1))[:, 0]
        peak = 10.0 ** torch.clamp(condition[:, 6] + log_gain, max=0.0)
        x = self.enter_middle(torch.cat([self.up_middle(x), middle_skip, condition_planes(condition, 8)], dim=1))
        for block in self.middle:
            x = block(x, h)
        x = self.enter_fine(torch.cat([self.up_fine(x), fine_skip, condition_planes(condition, 16)], dim=1))
        for block in self.fine:
            x = block(x, h)
        field = depth_to_space(self.head(x), FIELD_SIZE // 16)
        height = cell_centres(FIELD_SIZE, field)[2]
        return field * torch.tanh(height / CLAMP_HEIGHT) * peak[:, None, None, None, None]


def _normalised(condition: Tensor) -> Tensor:
    return (condition - condition.new_tensor(SERVED_CENTRE)) * condition.new_tensor(SERVED_SCALE)


class DeformationNetwork(nn.Module):
    """E and G together; `rest` is one body, `condition` holds any number of loads on it (or one body for each)."""

    def __init__(self, config: DeformationConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = ShapeEncoder(config)
        self.generator = LoadGenerator(config)

    def forward(
        self,
        rest: Float[Tensor, "bodies 1 64 64 64"],
        condition: Float[Tensor, "loads 9"],
        noise: Float[Tensor, "loads latent"],
    ) -> tuple[Float[Tensor, "loads 3 32 32 32"], Tensor, Tensor]:
        """Backward displacement in edges of the grid, and μ, log σ² of the latent.

        Args:
            rest: Undeformed occupancy; the loads are divided evenly among the bodies, in order.
            condition: See `service.core.condition`.
            noise: Standard normal for a sample of the posterior, zeros for its mean: z = μ + σ·noise.
        """
        fine, middle, coarse, mean, log_variance = self.encoder(rest)
        if rest.shape[0] == 1:  # as served: the number of loads is free, and nothing is copied
            loads = condition.shape[0]
            fine, middle, coarse = (f.expand(loads, -1, -1, -1, -1) for f in (fine, middle, coarse))
        else:
            each = condition.shape[0] // rest.shape[0]
            fine, middle, coarse, mean, log_variance = (
                f.repeat_interleave(each, dim=0) for f in (fine, middle, coarse, mean, log_variance)
            )
        z = mean + torch.exp(0.5 * log_variance) * noise
        return self.generator(fine, middle, coarse, z, condition), mean, log_variance


def sample_field(
    field: Float[Tensor, "batch c x y z"],
    points: Float[Tensor, "batch n 3"],
    outside: Literal["border", "zeros"] = "border",
) -> Float[Tensor, "batch c n"]:
    """Trilinear lookup of a field over the unit cube, differentiable in both.

    Args:
        field: Values at the centres of a regular lattice.
        points: Where to look; x, y, z in [0, 1] inside the cube.
        outside: `border` holds the last value, as for a displacement; `zeros` falls to nothing, as for a body.

    torch's grid_sample indexes the last axis first, hence the flip.
    """
    grid = (2.0 * points - 1.0).flip(-1)[:, :, None, None, :]
    sampled = functional.grid_sample(field, grid, mode="bilinear", padding_mode=outside, align_corners=False)
    return sampled[:, :, :, 0, 0]


def at_voxels(
    field: Float[Tensor, "loads 3 32 32 32"], rest: Float[Tensor, "bodies 1 64 64 64"]
) -> Float[Tensor, "loads 3 64 64 64"]:
    """The field between its nodes, at the centre of every voxel, held to the clamp on the floor.

    The lowest voxels of the body at rest do not move: they lie half a voxel above what is clamped. Elsewhere the
    displacement is at most the voxel's height, which keeps y - u(y) above the floor.
    """
    fine = functional.interpolate(field, size=(64, 64, 64), mode="trilinear", align_corners=False)
    length = torch.sqrt((fine * fine).sum(dim=1, keepdim=True) + 1e-12)
    fine = fine * torch.clamp(cell_centres(64, fine)[2] / length, max=1.0)
    free = 1.0 - rest[..., :1]
    if rest.shape[0] > 1:
        free = free.repeat_interleave(field.shape[0] // rest.shape[0], dim=0)
    return torch.cat([fine[..., :1] * free, fine[..., 1:]], dim=-1)


def soft_warp(
    rest: Float[Tensor, "loads 1 64 64 64"], field: Float[Tensor, "loads 3 32 32 32"]
) -> Float[Tensor, "loads 64 64 64"]:
    """Deformed occupancy with a gradient in the field, for a critic to judge; `warp` is what serves."""
    source = cell_centres(64, field) - at_voxels(field, rest)
    points = source.flatten(2).transpose(1, 2)
    return sample_field(rest, points, outside="zeros").reshape(-1, 64, 64, 64)


@torch.no_grad()
def warp(
    rest: Float[Tensor, "bodies 1 64 64 64"], field: Float[Tensor, "loads 3 32 32 32"]
) -> Float[Tensor, "loads 64 64 64"]:
    """Deformed occupancy by the very lookup that serves; it has no gradient, `sample_field` has."""
    each = field.shape[0] // rest.shape[0]
    fine = at_voxels(field, rest).numpy()
    bodies = rest[:, 0].numpy() > 0.5
    return torch.from_numpy(np.stack([lookup.warp(bodies[i // each], fine[i]) for i in range(len(fine))]))
