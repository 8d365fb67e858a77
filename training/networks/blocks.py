"""What the networks are built from.

Those over the ground plane take the voxels of a vertical column for the channels of a pixel: a voxel's height means the
same everywhere, and convolutions of planes are what CPUs do best, twice as fast as those of space.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

LEAKY_SLOPE = 0.2
"""Source: the authors' released code; Table 1 of the paper says ReLU."""


class PlaneBlock(nn.Module):
    """Convolution, batch normalisation (folded away at export) and leaky ReLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1) -> None:
        super().__init__()
        padding = (kernel - 1) // 2 if stride == 1 else 0
        self.conv = nn.Conv2d(inputs, outputs, kernel, stride, padding, bias=False)
        self.norm = nn.BatchNorm2d(outputs)
        self.activation = nn.LeakyReLU(LEAKY_SLOPE)

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.activation(self.norm(self.conv(x)))
        return y


class Stem(nn.Module):
    """A coarser plane by a convolution whose kernels touch, as one product of matrices, of channels that lie last.

    What a graph is given lies so; to put its channels first takes longer than the product.
    """

    def __init__(self, inputs: int, outputs: int, factor: int) -> None:
        super().__init__()
        self.factor = factor
        self.conv = nn.Conv2d(inputs, outputs, factor, factor, bias=False)
        self.norm: nn.Module = nn.BatchNorm2d(outputs)
        self.activation = nn.LeakyReLU(LEAKY_SLOPE)

    def forward(self, x: Float[Tensor, "batch width depth inputs"]) -> Float[Tensor, "batch outputs x y"]:
        batch, width, depth, channels = x.shape
        n = self.factor
        parts = x.reshape(batch, width // n, n, depth // n, n, channels).permute(0, 1, 3, 2, 4, 5)
        weight = self.conv.weight.permute(0, 2, 3, 1).flatten(1)
        y = nn.functional.linear(parts.flatten(3), weight, self.conv.bias)
        z: Tensor = self.activation(self.norm(y.permute(0, 3, 1, 2)))
        return z


class ResidualPlaneBlock(nn.Module):
    """One 3² convolution around which the signal also passes unchanged.

    Args:
        channels: Of the signal.
        silent: At first the signal passes alone: a trained network that is given more blocks begins with what it knew.
            Source: Goyal et al., "Accurate, Large Minibatch SGD: Training ImageNet in 1 Hour", 2017, section 5.1.
    """

    def __init__(self, channels: int, silent: bool = False) -> None:
        super().__init__()
        self.block = PlaneBlock(channels, channels, 3)
        if silent:
            nn.init.zeros_(self.block.norm.weight)

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = x + self.block(x)
        return y


class ModulatedPlaneBlock(nn.Module):
    """A residual block whose channels are scaled and shifted by the condition.

    Source: FiLM, Perez et al., AAAI 2018, eq. 2.
    """

    def __init__(self, channels: int, condition: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(channels, channels, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm2d(channels)
        self.modulation = nn.Linear(condition, 2 * channels)
        nn.init.zeros_(self.modulation.weight)
        nn.init.zeros_(self.modulation.bias)
        self.activation = nn.LeakyReLU(LEAKY_SLOPE)

    def forward(self, x: Float[Tensor, "batch c x y"], condition: Float[Tensor, "batch h"]) -> Tensor:
        channels = self.conv.out_channels
        scale, shift = self.modulation(condition).reshape(-1, 2 * channels, 1, 1).split(channels, dim=1)
        y: Tensor = x + self.activation(self.norm(self.conv(x)) * (1 + scale) + shift)
        return y


def cell_centres(size: int, like: Tensor) -> Float[Tensor, "axis=3 x y z"]:
    """Centres of a `size`³ lattice over the unit cube."""
    steps = (torch.arange(size, device=like.device, dtype=like.dtype) + 0.5) / size
    return torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"))
