"""The paper's conditional VAE generator, for a CPU: a body is encoded once, every load decodes what to add to a prior.

A coarse elastic solve (`service.core.prior`) says where the body goes; the network sees the body, the load and that
answer, and decodes a correction: the prior's field turned and scaled, and a field of its own. The correction is told
of the material, where the body was at rest, so that it lines up with what the encoder saw. Detail of the shape passes
through unblurred: the deformed occupancy is the undeformed one, looked up where the material came from.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from service.core.lookup import SURE
from service.core.prior_lattice import LATTICE_SIZE
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
STEM_CHANNELS = 32
CLAMP_HEIGHT = 4.0 / 64.0
"""The body is clamped on the floor: the correction is scaled by tanh(z / this), in edges of the grid."""

CONDITION_SIZE = 9
ANY_LOAD = (0.5, 0.5, 0.5, 0.0, 0.0, -1.0, -3.0, 0.25, 0.1)
"""What a network that is not to know of the load is told instead."""

MATRIX = 9
"""Entries of a 3×3 matrix."""

NARROW = -4.0
"""log σ² that training starts from."""

SMALLEST_SCALE = 1e-5
"""Displacements, in edges of the grid, below which the prior counts as still."""


@dataclass(frozen=True)
class DeformationConfig:
    """Sizes of the network.

    Attributes:
        channels: At 8³ and at 4³.
        blocks: Residual blocks of the encoder and of the generator at 8³ and at 4³.
        latent: Of μ and of σ.
        condition: Of the embedded condition.
        prior: False for the ablation that answers from body and load alone.
        skips: False for the ablation in which nothing but the latent tells the generator of the body.
        conditioned: False for the ablation that never learns of the load.
        log_gain: Mean over the training set of log10(peak displacement / load number): the scale without a prior.
    """

    channels: tuple[int, int] = (40, 96)
    blocks: tuple[int, int] = (2, 2)
    latent: int = 16
    condition: int = 64
    prior: bool = True
    skips: bool = True
    conditioned: bool = True
    log_gain: float = 0.0


class ShapeEncoder(nn.Module):
    """E: features of the undeformed body at 8³ and 4³, and the latent's μ and log σ²."""

    def __init__(self, config: DeformationConfig) -> None:
        super().__init__()
        middle, coarse = config.channels
        self.stem = ConvBlock(BLOCK**3, STEM_CHANNELS, 1)
        self.middle = nn.Sequential(
            ConvBlock(STEM_CHANNELS, middle, 2, 2), *(ResidualBlock(middle) for _ in range(config.blocks[0]))
        )
        self.coarse = nn.Sequential(
            ConvBlock(middle, coarse, 2, 2), *(ResidualBlock(coarse) for _ in range(config.blocks[1]))
        )
        self.latent = nn.Linear(coarse, 2 * config.latent)
        # A narrow posterior to begin with: noise of unit variance would drown what little the latent says at first.
        nn.init.constant_(self.latent.bias[config.latent :], NARROW)

    def forward(self, rest: Float[Tensor, "batch 1 64 64 64"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        middle = self.middle(self.stem(space_to_depth(rest, BLOCK)))
        coarse = self.coarse(middle)
        mean, log_variance = self.latent(coarse.mean(dim=(2, 3, 4))).chunk(2, dim=1)
        return middle, coarse, mean, log_variance


class LoadGenerator(nn.Module):
    """G: latent, condition, prior and the encoder's skips to the correction for one load."""

    def __init__(self, config: DeformationConfig) -> None:
        super().__init__()
        self.config = config
        middle, coarse = config.channels
        hidden = config.condition
        self.embed = nn.Sequential(
            nn.Linear(CONDITION_SIZE + 1 + config.latent, hidden), nn.LeakyReLU(LEAKY_SLOPE),
            nn.Linear(hidden, hidden), nn.LeakyReLU(LEAKY_SLOPE),
        )  # fmt: skip
        self.load_middle = ConvBlock(3 * 2**3 + PLANES, middle, 1)
        self.load_coarse = ConvBlock(middle, coarse, 2, 2)
        self.enter_coarse = ConvBlock(2 * coarse + PLANES, coarse, 1)
        self.coarse = nn.ModuleList(ModulatedResidualBlock(coarse, hidden) for _ in range(config.blocks[1]))
        self.up = Upsample(coarse, middle)
        self.enter_middle = ConvBlock(3 * middle, middle, 1)
        self.middle = nn.ModuleList(ModulatedResidualBlock(middle, hidden) for _ in range(config.blocks[0]))
        self.head = _silent(nn.Conv3d(middle, MATRIX + 3 * 2**3, 1))
        self.whole = nn.Sequential(
            nn.Linear(coarse + hidden, hidden), nn.LeakyReLU(LEAKY_SLOPE), _silent(nn.Linear(hidden, 1 + MATRIX))
        )

    def forward(
        self, middle_skip: Tensor, coarse_skip: Tensor, z: Tensor, condition: Tensor,
        prior: Float[Tensor, "batch 3 16 16 16"],
    ) -> Float[Tensor, "batch 3 16 16 16"]:  # fmt: skip
        config = self.config
        if not config.conditioned:
            condition = condition.new_tensor(ANY_LOAD).expand_as(condition)
        if not config.skips:
            middle_skip, coarse_skip = torch.zeros_like(middle_skip), torch.zeros_like(coarse_skip)
        if config.prior:
            scale = prior.norm(dim=1).amax(dim=(1, 2, 3)).clamp(min=SMALLEST_SCALE)
        else:
            prior = torch.zeros_like(prior)
            scale = 10.0 ** torch.clamp(condition[:, 6] + config.log_gain, max=0.0)
        told = torch.cat([_normalised(condition), torch.log10(scale)[:, None] + 1.0, z], dim=1)
        h = self.embed(told)
        shown = prior / scale[:, None, None, None, None]
        load = self.load_middle(torch.cat([space_to_depth(shown, 2), condition_planes(condition, 8)], dim=1))
        x = self.enter_coarse(torch.cat([coarse_skip, self.load_coarse(load), condition_planes(condition, 4)], dim=1))
        for block in self.coarse:
            x = block(x, h)
        whole = self.whole(torch.cat([x.mean(dim=(2, 3, 4)), h], dim=1))
        x = self.enter_middle(torch.cat([self.up(x), middle_skip, load], dim=1))
        for block in self.middle:
            x = block(x, h)
        local = self.head(x)
        # Most of what a coarse solve misses is how soft the body is, as a whole and along each axis: a factor and
        # a matrix for all of it, a matrix that varies from place to place, and what no multiple of the prior can say.
        matrix = functional.interpolate(local[:, :MATRIX], size=(LATTICE_SIZE,) * 3, mode="trilinear")
        matrix = (matrix + whole[:, 1:, None, None, None]).unflatten(1, (3, 3))
        own = depth_to_space(local[:, MATRIX:], 2) * scale[:, None, None, None, None]
        if not config.prior:
            own = own * (1.0 + whole[:, :1, None, None, None])
        correction = own + whole[:, :1, None, None, None] * prior + (matrix * prior[:, None]).sum(dim=2)
        held: Tensor = correction * torch.tanh(cell_centres(LATTICE_SIZE, correction)[2] / CLAMP_HEIGHT)
        return held


def _silent(layer: nn.Linear | nn.Conv3d) -> nn.Linear | nn.Conv3d:
    """The last layer, saying nothing at first: training starts at the prior."""
    nn.init.zeros_(layer.weight)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
    return layer


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
        prior: Float[Tensor, "loads 3 16 16 16"],
    ) -> tuple[Float[Tensor, "loads 3 16 16 16"], Tensor, Tensor]:
        """What to add to the prior's displacement of the material, in edges of the grid, and μ, log σ² of the latent.

        Args:
            rest: Undeformed occupancy; the loads are divided evenly among the bodies, in order.
            condition: See `service.core.condition`.
            noise: Standard normal for a sample of the posterior, zeros for its mean: z = μ + σ·noise.
            prior: u(x) of the coarse solve, see `service.core.prior_lattice`.
        """
        middle, coarse, mean, log_variance = self.encoder(rest)
        if rest.shape[0] == 1:  # as served: the number of loads is free, and nothing is copied
            loads = condition.shape[0]
            middle, coarse = (f.expand(loads, -1, -1, -1, -1) for f in (middle, coarse))
        else:
            each = condition.shape[0] // rest.shape[0]
            middle, coarse, mean, log_variance = (
                f.repeat_interleave(each, dim=0) for f in (middle, coarse, mean, log_variance)
            )
        z = mean + torch.exp(0.5 * log_variance) * noise
        return self.generator(middle, coarse, z, condition, prior), mean, log_variance


def shrunk(network: DeformationNetwork, share: float) -> DeformationNetwork:
    """A copy that says this share of every correction: its last layers, in which the correction is linear, scaled."""
    copied = copy.deepcopy(network)
    for layer in (copied.generator.head, copied.generator.whole[-1]):
        for parameter in layer.parameters():
            parameter.data *= share
    return copied


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


def displacement_at(
    correction: Float[Tensor, "batch 3 16 16 16"],
    backward: Float[Tensor, "batch 3 32 32 32"],
    points: Float[Tensor, "batch n 3"],
) -> Float[Tensor, "batch 3 n"]:
    """Backward displacement at places of the deformed body, with a gradient in the correction.

    Args:
        correction: The network's.
        backward: u_b of the coarse solve; zeros without one, when the correction is all there is.
        points: x, y, z in edges of the grid.

    Source: `service.core.displacement.corrected`, which serves.
    """
    moved = sample_field(correction, points - sample_field(backward, points).transpose(1, 2))
    return moved + sample_field(backward, points - moved.transpose(1, 2))


def smoothed(occupancy: Float[Tensor, "bodies 1 64 64 64"]) -> Float[Tensor, "bodies 1 64 64 64"]:
    """`service.core.lookup.smoothed` of a batch."""
    values = occupancy
    for axis in (2, 3, 4):
        size = values.shape[axis]
        mean = 0.5 * values
        mean.narrow(axis, 1, size - 1).add_(values.narrow(axis, 0, size - 1), alpha=0.25)
        mean.narrow(axis, 0, size - 1).add_(values.narrow(axis, 1, size - 1), alpha=0.25)
        if axis == 4:
            mean.narrow(axis, 0, 1).add_(values.narrow(axis, 0, 1), alpha=0.25)
        values = mean
    return torch.where(occupancy > 0.5, values.clamp(min=0.5 + SURE), values.clamp(max=0.5 - SURE))


def soft_warp(
    rest: Float[Tensor, "loads 1 64 64 64"],
    correction: Float[Tensor, "loads 3 16 16 16"],
    backward: Float[Tensor, "loads 3 32 32 32"],
) -> Float[Tensor, "loads 64 64 64"]:
    """Deformed occupancy with a gradient in the correction, for a critic to judge."""
    points = cell_centres(64, correction).flatten(1).T.expand(len(correction), -1, -1)
    source = points - displacement_at(correction, backward, points).transpose(1, 2)
    return sample_field(smoothed(rest), source, outside="zeros").reshape(-1, 64, 64, 64)
