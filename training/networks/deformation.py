"""The paper's conditional VAE generator, for a CPU: a body is encoded once, every load decodes what to add to a prior.

A coarse elastic solve (`service.core.prior`) says where the body goes; the network sees the body, the load and that
answer, and decodes a correction: the prior's field turned and scaled, and a field of its own. The correction is told
of the material, where the body was at rest, so that it lines up with what the encoder saw. Detail of the shape passes
through unblurred: the deformed occupancy is the undeformed one, looked up where the material came from.

Both work over the ground plane, with the voxels of a vertical column as channels, in a quarter of the time of the
network in space before them and a tenth for each further load (docs/runs.md).
"""

from __future__ import annotations

import copy
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from service.core.prior_lattice import LATTICE_SIZE
from training.networks.blocks import (
    LEAKY_SLOPE,
    ModulatedPlaneBlock,
    PlaneBlock,
    ResidualPlaneBlock,
    Stem,
    cell_centres,
)
from training.networks.conditions import PLANES, SERVED_CENTRE, SERVED_SCALE, condition_planes

COLUMN = 64
"""Voxels of a column."""

STEM = 4
"""Columns along each edge of what becomes one pixel."""

CLAMP_HEIGHT = 4.0 / 64.0
"""The body is clamped on the floor: the correction is scaled by tanh(z / this), in edges of the grid."""

SHAPE = (LATTICE_SIZE,) * 3
"""Written out wherever a tensor takes another shape: an exported graph works out at every run what is not said."""

CONDITION_SIZE = 9
ANY_LOAD = (0.5, 0.5, 0.5, 0.0, 0.0, -1.0, -3.0, 0.25, 0.1)
"""What a network that is not to know of the load is told instead."""

TERMS = 16
"""What a displacement of the whole body is made of: the prior, the prior times x, y and z, and 1, x, y and z."""

NARROW = -4.0
"""log σ² that training starts from."""

SMALLEST_SCALE = 1e-5
"""Displacements, in edges of the grid, below which the prior counts as still."""


@dataclass(frozen=True)
class DeformationConfig:
    """Sizes of the network.

    Attributes:
        channels: At 16², 8² and 4² over the ground plane.
        encoder_blocks: Residual blocks of the encoder at each of them.
        generator_blocks: Residual blocks of the generator at 8² and at 4².
        latent: Of μ and of σ.
        condition: Of the embedded condition.
        prior: False for the ablation that answers from body and load alone.
        skips: False for the ablation in which nothing but the latent tells the generator of the body.
        conditioned: False for the ablation that never learns of the load.
        log_gain: Mean over the training set of log10(peak displacement / load number): the scale without a prior.
    """

    channels: tuple[int, int, int] = (64, 80, 112)
    encoder_blocks: tuple[int, int, int] = (1, 1, 1)
    generator_blocks: tuple[int, int] = (1, 1)
    latent: int = 16
    condition: int = 64
    prior: bool = True
    skips: bool = True
    conditioned: bool = True
    log_gain: float = 0.0


class ShapeEncoder(nn.Module):
    """E: features of the undeformed body at 8² and 4², and the latent's μ and log σ²."""

    def __init__(self, config: DeformationConfig) -> None:
        super().__init__()
        fine, middle, coarse = config.channels
        self.middle = nn.Sequential(
            Stem(COLUMN, fine, STEM), *_residual(fine, config.encoder_blocks[0]),
            PlaneBlock(fine, middle, 2, 2), *_residual(middle, config.encoder_blocks[1]),
        )  # fmt: skip
        self.coarse = nn.Sequential(PlaneBlock(middle, coarse, 2, 2), *_residual(coarse, config.encoder_blocks[2]))
        self.latent = nn.Linear(coarse, 2 * config.latent)
        # A narrow posterior to begin with: noise of unit variance would drown what little the latent says at first.
        nn.init.constant_(self.latent.bias[config.latent :], NARROW)

    def forward(self, rest: Float[Tensor, "batch 1 64 64 64"]) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        middle = self.middle(rest.squeeze(1))
        coarse = self.coarse(middle)
        mean, log_variance = self.latent(coarse.mean(dim=(2, 3))).chunk(2, dim=1)
        return middle, coarse, mean, log_variance


class LoadGenerator(nn.Module):
    """G: latent, condition, prior and the encoder's skips to the correction for one load."""

    def __init__(self, config: DeformationConfig) -> None:
        super().__init__()
        self.config = config
        _, middle, coarse = config.channels
        hidden = config.condition
        self.embed = nn.Sequential(
            nn.Linear(CONDITION_SIZE + 1 + config.latent, hidden), nn.LeakyReLU(LEAKY_SLOPE),
            nn.Linear(hidden, hidden), nn.LeakyReLU(LEAKY_SLOPE),
        )  # fmt: skip
        self.show = PlaneBlock(3 * LATTICE_SIZE, middle, 2, 2)
        self.load_middle = PlaneBlock(middle + PLANES * 8, middle, 1)
        self.load_coarse = PlaneBlock(middle, coarse, 2, 2)
        self.enter_coarse = PlaneBlock(2 * coarse, coarse, 1)
        self.coarse = nn.ModuleList(ModulatedPlaneBlock(coarse, hidden) for _ in range(config.generator_blocks[1]))
        self.up = nn.ConvTranspose2d(coarse, middle, 2, 2)
        self.enter_middle = PlaneBlock(3 * middle, middle, 1)
        self.middle = nn.ModuleList(ModulatedPlaneBlock(middle, hidden) for _ in range(config.generator_blocks[0]))
        self.local = _silent(nn.Conv2d(middle, LATTICE_SIZE, 1))
        self.own = _silent(nn.ConvTranspose2d(middle, 3 * LATTICE_SIZE, 2, 2))
        self.whole = nn.Sequential(
            nn.Linear(coarse + hidden, hidden), nn.LeakyReLU(LEAKY_SLOPE), _silent(nn.Linear(hidden, 1 + 3 * TERMS))
        )

    @property
    def last_layers(self) -> tuple[nn.Module, ...]:
        """In which the correction is linear, where there is a prior."""
        return self.local, self.own, self.whole[-1]

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
            u, v, w = prior.unbind(dim=1)  # a norm over the second axis is among the slowest steps in ONNX Runtime
            scale = torch.sqrt((u * u + v * v + w * w).amax(dim=(1, 2, 3))).clamp(min=SMALLEST_SCALE)
        else:
            prior = torch.zeros_like(prior)
            scale = 10.0 ** torch.clamp(condition[:, 6] + config.log_gain, max=0.0)
        told = torch.cat([_normalised(condition), torch.log10(scale)[:, None] + 1.0, z], dim=1)
        h = self.embed(told)
        spread = scale.reshape(-1, 1, 1, 1, 1)
        shown = _columns(prior / spread, 3, LATTICE_SIZE)
        around = _columns(condition_planes(condition, 8), PLANES, 8)
        load = self.load_middle(torch.cat([self.show(shown), around], dim=1))
        x = self.enter_coarse(torch.cat([coarse_skip, self.load_coarse(load)], dim=1))
        for block in self.coarse:
            x = block(x, h)
        whole = self.whole(torch.cat([x.mean(dim=(2, 3)), h], dim=1))
        x = self.enter_middle(torch.cat([self.up(x), middle_skip, load], dim=1))
        for block in self.middle:
            x = block(x, h)
        # Most of what a coarse solve misses is how soft the body is, as a whole and from end to end: a factor, and
        # what is affine in the prior and in the place; then a factor that varies from place to place, and what no
        # multiple of the prior can say.
        local = functional.interpolate(self.local(x), scale_factor=2.0, mode="bilinear", align_corners=False)
        most = whole[:, :1].reshape(-1, 1, 1, 1, 1)
        factor = most + local[:, None]
        own = self.own(x).reshape(-1, 3, *SHAPE)
        if not config.prior:
            own = own * (1.0 + most)
        own = own + affine_of(shown, whole[:, 1:]) + factor * shown.reshape(-1, 3, *SHAPE)
        height = cell_centres(LATTICE_SIZE, own)[2, 0, 0] / CLAMP_HEIGHT
        held: Tensor = own * (spread * torch.tanh(height)[:, None, None])
        return held.permute(0, 1, 3, 4, 2)


def affine_of(
    shown: Float[Tensor, "batch 48 16 16"], share: Float[Tensor, "batch 48"]
) -> Float[Tensor, "batch 3 16 16 16"]:
    """Sums of `TERMS` fields for each axis, all in columns: axis, z, x, y.

    Args:
        shown: The prior.
        share: Of every term in every axis of the sum.
    """
    centres = cell_centres(LATTICE_SIZE, shown) - 0.5
    place = torch.cat([torch.ones_like(centres[:1]), centres]).permute(0, 3, 1, 2).flatten(1)
    moved = (place[:, None] * shown.reshape(-1, 1, 3, LATTICE_SIZE**3)).reshape(-1, TERMS - 4, LATTICE_SIZE**3)
    share = share.reshape(-1, 3, TERMS)
    total = torch.matmul(share[:, :, : TERMS - 4], moved) + torch.matmul(share[:, :, TERMS - 4 :], place)
    return total.reshape(-1, 3, *SHAPE)


def _columns(fields: Float[Tensor, "batch c x y z"], count: int, size: int) -> Float[Tensor, "batch cz x y"]:
    """Columns along z as channels, of `count` fields on lattices of `size`³."""
    return fields.permute(0, 1, 4, 2, 3).reshape(-1, count * size, size, size)


def _residual(channels: int, count: int) -> list[nn.Module]:
    return [ResidualPlaneBlock(channels) for _ in range(count)]


def _silent(layer: nn.Linear | nn.Conv2d | nn.ConvTranspose2d) -> nn.Linear | nn.Conv2d | nn.ConvTranspose2d:
    """The last layer, saying nothing at first: training starts at the prior."""
    nn.init.zeros_(layer.weight)
    if layer.bias is not None:
        nn.init.zeros_(layer.bias)
    return layer


def _normalised(condition: Tensor) -> Tensor:
    return (condition - condition.new_tensor(SERVED_CENTRE)) * condition.new_tensor(SERVED_SCALE)


class DeformationNetwork(nn.Module):
    """E and G together; `rest` is one body, `condition` holds any number of loads on it (or one body for each)."""

    memory_format = torch.channels_last
    """In which a CPU trains it fastest."""

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
        if rest.shape[0] > 1:
            each = condition.shape[0] // rest.shape[0]
            middle, coarse, mean, log_variance = (
                f.repeat_interleave(each, dim=0) for f in (middle, coarse, mean, log_variance)
            )
        deviation = torch.exp(0.5 * log_variance)
        return self.generate(middle, coarse, mean, deviation, condition, noise, prior), mean, log_variance

    def generate(
        self, middle: Tensor, coarse: Tensor, mean: Tensor, deviation: Tensor, condition: Tensor, noise: Tensor,
        prior: Tensor,
    ) -> Float[Tensor, "loads 3 16 16 16"]:  # fmt: skip
        """The correction, from what the encoder says of one body or of that of each load; σ is the deviation."""
        if len(middle) == 1:  # as served: the number of loads is free
            loads = condition.shape[0]
            middle, coarse = middle.repeat(loads, 1, 1, 1), coarse.repeat(loads, 1, 1, 1)
        correction: Tensor = self.generator(middle, coarse, mean + deviation * noise, condition, prior)
        return correction


def shrunk(network: DeformationNetwork, share: float) -> DeformationNetwork:
    """A copy that says this share of every correction: its last layers, in which the correction is linear, scaled."""
    copied = copy.deepcopy(network)
    for layer in copied.generator.last_layers:
        for parameter in layer.parameters():
            parameter.data *= share
    return copied
