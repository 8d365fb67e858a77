"""3D-RecGAN's generator, resized for a CPU: what a view says about 64³ voxels in, the full shape out.

Source: Yang et al., "3D Object Reconstruction from a Single Depth View with Adversarial Learning", ICCVW 2017.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from training.networks.blocks import ConvBlock, ResidualBlock, Upsample, depth_to_space, space_to_depth

BLOCK = 4
"""The network works on 16³ cells of 4³ voxels."""


@dataclass(frozen=True)
class ReconstructionConfig:
    """Channels at 16³, 8³ and 4³, and residual blocks at each."""

    channels: tuple[int, int, int] = (48, 96, 160)
    blocks: tuple[int, int, int] = (1, 2, 3)
    head: int = 96


class ReconstructionNetwork(nn.Module):
    """U-Net from (observed, free) to the logit of occupancy of every voxel."""

    def __init__(self, config: ReconstructionConfig) -> None:
        super().__init__()
        self.config = config
        fine, middle, coarse = config.channels
        fine_blocks, middle_blocks, coarse_blocks = config.blocks
        self.stem = nn.Sequential(ConvBlock(2 * BLOCK**3, fine, 1), *[ResidualBlock(fine) for _ in range(fine_blocks)])
        self.down_middle = nn.Sequential(
            ConvBlock(fine, middle, 2, 2), *[ResidualBlock(middle) for _ in range(middle_blocks)]
        )
        self.down_coarse = nn.Sequential(
            ConvBlock(middle, coarse, 2, 2), *[ResidualBlock(coarse) for _ in range(coarse_blocks)]
        )
        self.up_middle = Upsample(coarse, middle)
        self.merge_middle = nn.Sequential(ConvBlock(2 * middle, middle, 1), ResidualBlock(middle))
        self.up_fine = Upsample(middle, fine)
        self.merge_fine = nn.Sequential(ConvBlock(2 * fine, fine, 1), ResidualBlock(fine))
        self.head = nn.Sequential(ConvBlock(fine + 2 * BLOCK**3, config.head, 1), nn.Conv3d(config.head, BLOCK**3, 1))

    def forward(self, view: Float[Tensor, "batch 2 64 64 64"]) -> Float[Tensor, "batch 64 64 64"]:
        """Logits. `view` holds 1 where a voxel is observed (channel 0) or free (channel 1)."""
        cells = space_to_depth(view, BLOCK)
        fine = self.stem(cells)
        middle = self.down_middle(fine)
        coarse = self.down_coarse(middle)
        middle = self.merge_middle(torch.cat([self.up_middle(coarse), middle], dim=1))
        fine = self.merge_fine(torch.cat([self.up_fine(middle), fine], dim=1))
        logits = self.head(torch.cat([fine, cells], dim=1))
        return depth_to_space(logits, BLOCK)[:, 0]
