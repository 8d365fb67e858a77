"""A single network from one view and a load straight to the deformed shape: what the cascade must beat.

The reconstruction network, told of the load at every size: as fields over the grid, and as factors and shifts of its
channels. What it is told says nothing at first, so that it begins as the reconstruction that its weights are taken of.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor, nn

from training.networks.blocks import LEAKY_SLOPE, ModulatedPlaneBlock
from training.networks.conditions import ConditionConfig
from training.networks.reconstruction import SIZE, ReconstructionConfig, ReconstructionNetwork


@dataclass(frozen=True)
class DirectConfig:
    """Sizes of the network.

    Attributes:
        shape: Of the reconstruction network in it.
        condition: How the load is encoded.
        hidden: Of the embedded condition.
    """

    shape: ReconstructionConfig = field(default_factory=ReconstructionConfig)
    condition: ConditionConfig = field(default_factory=ConditionConfig)
    hidden: int = 64


class LoadBlock(nn.Module):
    """Tells features of the load; nothing at first."""

    def __init__(self, channels: int, planes: int, hidden: int) -> None:
        super().__init__()
        self.shown = nn.Conv2d(planes, channels, 1)
        self.block = ModulatedPlaneBlock(channels, hidden)
        for silent in (self.shown.weight, self.shown.bias, self.block.norm.weight):
            assert silent is not None
            nn.init.zeros_(silent)

    def forward(self, x: Float[Tensor, "batch c x y"], fields: Tensor, h: Tensor) -> Tensor:
        y: Tensor = self.block(x + self.shown(fields), h)
        return y


class DirectNetwork(nn.Module):
    """From (observed, free) and a load, both in the view grid, to the logit of every voxel of the deformed body."""

    memory_format = torch.channels_last

    def __init__(self, config: DirectConfig) -> None:
        super().__init__()
        self.config = config
        self.shape = ReconstructionNetwork(config.shape)
        hidden = config.hidden
        self.embed = nn.Sequential(
            nn.Linear(config.condition.width, hidden), nn.LeakyReLU(LEAKY_SLOPE),
            nn.Linear(hidden, hidden), nn.LeakyReLU(LEAKY_SLOPE),
        )  # fmt: skip
        sizes = [SIZE // 2 ** (level + 1) for level in range(len(config.shape.channels))]
        down = list(zip(config.shape.channels, sizes, strict=True))
        self.sizes = sizes + sizes[-2::-1]
        self.loads = nn.ModuleList(
            LoadBlock(channels, config.condition.planes * size, hidden) for channels, size in down + down[-2::-1]
        )

    def forward(
        self, view: Float[Tensor, "batch 2 64 64 64"], condition: Float[Tensor, "batch 9"]
    ) -> Float[Tensor, "batch 64 64 64"]:
        """Logits of the deformed body; see `ReconstructionNetwork.forward` and `service.core.condition`."""
        h = self.embed(self.config.condition.encoded(condition))
        fields = {
            size: self.config.condition.fields(condition, size).permute(0, 1, 4, 2, 3).flatten(1, 2)
            for size in set(self.sizes)
        }
        loads = iter(zip(self.loads, self.sizes, strict=True))

        def told(x: Tensor) -> Tensor:
            load, size = next(loads)
            y: Tensor = load(x, fields[size], h)
            return y

        logits: Tensor = self.shape(view, told)
        return logits
