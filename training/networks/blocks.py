"""What the networks are built from."""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor, nn

LEAKY_SLOPE = 0.2
"""Source: the authors' released code; Table 1 of the paper says ReLU."""


def space_to_depth(x: Float[Tensor, "batch c x y z"], block: int) -> Float[Tensor, "batch cb xb yb zb"]:
    """Fold blocks of voxels into channels: a stride without a loss, and far cheaper than convolving at 64³."""
    batch, channels, size, _, _ = x.shape
    small = size // block
    x = x.reshape(batch, channels, small, block, small, block, small, block)
    x = x.permute(0, 1, 3, 5, 7, 2, 4, 6)
    return x.reshape(batch, channels * block**3, small, small, small)


def depth_to_space(x: Float[Tensor, "batch cb xb yb zb"], block: int) -> Float[Tensor, "batch c x y z"]:
    """Inverse of `space_to_depth`."""
    batch, channels, small, _, _ = x.shape
    out = channels // block**3
    x = x.reshape(batch, out, block, block, block, small, small, small)
    x = x.permute(0, 1, 5, 2, 6, 3, 7, 4)
    return x.reshape(batch, out, small * block, small * block, small * block)


class ConvBlock(nn.Module):
    """Convolution, batch normalisation (folded away at export) and leaky ReLU."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1) -> None:
        super().__init__()
        padding = (kernel - 1) // 2 if stride == 1 else 0
        self.conv = nn.Conv3d(inputs, outputs, kernel, stride, padding, bias=False)
        self.norm = nn.BatchNorm3d(outputs)
        self.activation = nn.LeakyReLU(LEAKY_SLOPE)

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.activation(self.norm(self.conv(x)))
        return y


class ResidualBlock(nn.Module):
    """One 3³ convolution around which the signal also passes unchanged."""

    def __init__(self, channels: int) -> None:
        super().__init__()
        self.block = ConvBlock(channels, channels, 3)

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = x + self.block(x)
        return y


class ModulatedResidualBlock(nn.Module):
    """A residual block whose channels are scaled and shifted by the condition.

    Source: FiLM, Perez et al., AAAI 2018, eq. 2.
    """

    def __init__(self, channels: int, condition: int) -> None:
        super().__init__()
        self.conv = nn.Conv3d(channels, channels, 3, padding=1, bias=False)
        self.norm = nn.BatchNorm3d(channels)
        self.modulation = nn.Linear(condition, 2 * channels)
        nn.init.zeros_(self.modulation.weight)
        nn.init.zeros_(self.modulation.bias)
        self.activation = nn.LeakyReLU(LEAKY_SLOPE)

    def forward(self, x: Float[Tensor, "batch c x y z"], condition: Float[Tensor, "batch h"]) -> Tensor:
        scale, shift = self.modulation(condition)[:, :, None, None, None].chunk(2, dim=1)
        y: Tensor = x + self.activation(self.norm(self.conv(x)) * (1 + scale) + shift)
        return y


class Upsample(nn.Module):
    """Twice the resolution by a 2³ transposed convolution: no overlap, hence no checkerboard."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.ConvTranspose3d(inputs, outputs, 2, 2)

    def forward(self, x: Tensor) -> Tensor:
        y: Tensor = self.conv(x)
        return y


def cell_centres(size: int, like: Tensor) -> Float[Tensor, "axis=3 x y z"]:
    """Centres of a `size`³ lattice over the unit cube."""
    steps = (torch.arange(size, device=like.device, dtype=like.dtype) + 0.5) / size
    return torch.stack(torch.meshgrid(steps, steps, steps, indexing="ij"))
