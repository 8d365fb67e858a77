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


class ResidualPlaneBlock(nn.Module):
    """One 3² convolution around which the signal also passes unchanged."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.block = PlaneBlock(channels, channels, 3)

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
        scale, shift = self.modulation(condition)[:, :, None, None].chunk(2, dim=1)
        y: Tensor = x + self.activation(self.norm(self.conv(x)) * (1 + scale) + shift)
        return y


def cell_centres(size: int, like: Tensor) -> Float[Tensor, "axis=3 x y z"]:
    """Centres of a `size`³ lattice over the unit cube."""
    steps = (torch.arange(size, device=like.device, dtype=like.dtype) + 0.5) / size
    return torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"))
