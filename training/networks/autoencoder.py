"""The convolutions that the paper's networks share: an encoder to a dense code, a generator back with skips.

Source: 3D-PhysNet, Table 1, and the released code of 3D-RecGAN (Yang et al., ICCVW 2017), which it builds on. Table 1
counts five layers and both a stride and a pooling of 2; the released code has four, of stride 1, each pooled by 2,
which is what makes 64³ into 4³ and is done here.
"""

from __future__ import annotations

import itertools

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from training.networks.blocks import LEAKY_SLOPE

KERNEL = 4
COARSEST = 4
"""The encoder ends at 4³: 64 halved four times."""


class PooledConv(nn.Module):
    """A 4³ convolution of stride 1, leaky ReLU, and the largest of every 2³ block."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Conv3d(inputs, outputs, KERNEL)

    def forward(self, x: Float[Tensor, "batch c x y z"]) -> Tensor:
        # An even kernel has no middle: one voxel before, two after, as TensorFlow pads.
        x = functional.leaky_relu(self.conv(functional.pad(x, (1, 2) * 3)), LEAKY_SLOPE)
        return functional.max_pool3d(x, 2)


class ConvEncoder(nn.Module):
    """64³ to a code of `hidden` numbers, by way of features at 32³, 16³, 8³ and 4³."""

    def __init__(self, inputs: int, channels: tuple[int, int, int, int], hidden: int) -> None:
        super().__init__()
        self.layers = nn.ModuleList(PooledConv(a, b) for a, b in itertools.pairwise((inputs, *channels)))
        self.dense = nn.Linear(channels[-1] * COARSEST**3, hidden)

    def forward(self, x: Float[Tensor, "batch c 64 64 64"]) -> tuple[Float[Tensor, "batch hidden"], list[Tensor]]:
        """The code, and the features from fine to coarse."""
        features = []
        for layer in self.layers:
            x = layer(x)
            features.append(x)
        return functional.leaky_relu(self.dense(x.flatten(1)), LEAKY_SLOPE), features


class ConvGenerator(nn.Module):
    """A code to 64³ logits: a dense layer to 4³, then four transposed convolutions.

    Args:
        code: Numbers of the code.
        channels: Of the encoder, from fine to coarse; the generator goes back through them.
        skips: Whether the encoder's features are concatenated before every layer (U-Net).
        planes: Channels of the condition that are concatenated before every layer.
    """

    def __init__(self, code: int, channels: tuple[int, int, int, int], skips: bool, planes: int) -> None:
        super().__init__()
        self.dense = nn.Linear(code, channels[-1] * COARSEST**3)
        widths = tuple(reversed(channels))  # of what comes in: 4³, 8³, 16³, 32³
        self.layers = nn.ModuleList(
            nn.ConvTranspose3d(width * (2 if skips else 1) + planes, after, KERNEL, stride=2, padding=1)
            for width, after in zip(widths, (*widths[1:], 1), strict=True)
        )
        self._skips = skips
        self._coarsest = widths[0]

    def forward(
        self, code: Float[Tensor, "batch code"], features: list[Tensor], planes: list[Tensor]
    ) -> Float[Tensor, "batch 64 64 64"]:
        """Logits; `features` and `planes` from fine to coarse."""
        x = functional.leaky_relu(self.dense(code), LEAKY_SLOPE)
        x = x.unflatten(1, (self._coarsest, COARSEST, COARSEST, COARSEST))
        for depth, layer in enumerate(self.layers, start=1):
            beside = [features[-depth]] if self._skips else []
            x = layer(torch.cat([x, *beside, planes[-depth]], dim=1))
            if depth < len(self.layers):
                x = functional.leaky_relu(x, LEAKY_SLOPE)
        return x[:, 0]
