"""D: tells true outcomes from generated ones, given what was asked. Needed in training only.

Source: 3D-PhysNet, section 3.3 and Table 1; for reconstructions the same without a condition, as in 3D-RecGAN.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from training.networks.autoencoder import KERNEL
from training.networks.blocks import LEAKY_SLOPE
from training.networks.conditions import ConditionConfig, condition_slabs, slab_channels

FIRST_SIZE = 32
"""After the first layer."""


@dataclass(frozen=True)
class CriticConfig:
    """Defaults are the paper's.

    Attributes:
        given_channels: Of what the outcome is paired with: 1 for an undeformed body, 2 for a view.
        channels: At 32³, 16³, 8³ and 4³.
        condition: Encoding of the load; None for reconstructions.
    """

    given_channels: int = 1
    channels: tuple[int, int, int, int] = (64, 128, 256, 512)
    condition: ConditionConfig | None = None


class Critic(nn.Module):
    """Four strided 4³ convolutions over the pair (given, outcome).

    The condition joins after the first of them: as one channel of slabs for the paper's encodings, as fields for ours.
    The answer is the flattened last layer, 32,768 numbers in the paper, rather than one: a dense vector of
    similarities. It is linear, as a Wasserstein critic must be: the released code's sigmoid bounds the very distance
    that is measured. No batch normalisation: the gradient penalty is a property of each sample.
    """

    memory_format = torch.channels_last_3d
    """In which a step, with its penalty, takes four fifths of the time."""

    def __init__(self, config: CriticConfig) -> None:
        super().__init__()
        self.config = config
        condition = config.condition
        extra = 0 if condition is None else condition.planes or slab_channels(condition.width, FIRST_SIZE)
        inputs = (config.given_channels + 1, config.channels[0] + extra, *config.channels[1:-1])
        self.layers = nn.ModuleList(
            nn.Conv3d(a, b, KERNEL, stride=2, padding=1) for a, b in zip(inputs, config.channels, strict=True)
        )

    def forward(
        self,
        given: Float[Tensor, "batch c 64 64 64"],
        condition: Float[Tensor, "batch fields"] | None,
        outcome: Float[Tensor, "batch 64 64 64"],
    ) -> Float[Tensor, "batch similarities"]:
        """D(o|x): how true `outcome` looks; of `condition` only what the configuration says is read."""
        first, *others = self.layers
        x = functional.leaky_relu(first(torch.cat([given, outcome[:, None]], dim=1)), LEAKY_SLOPE)
        if self.config.condition is not None:
            x = torch.cat([x, self._condition_channels(condition)], dim=1)
        for layer in others[:-1]:
            x = functional.leaky_relu(layer(x), LEAKY_SLOPE)
        similarity: Tensor = others[-1](x)
        return similarity.flatten(1)

    def _condition_channels(self, condition: Tensor | None) -> Tensor:
        encoding = self.config.condition
        if encoding is None or condition is None:
            raise ValueError("this critic judges outcomes of a condition, and none was given")
        if encoding.planes:
            return encoding.fields(condition, FIRST_SIZE)
        return condition_slabs(encoding.encoded(condition), FIRST_SIZE)
