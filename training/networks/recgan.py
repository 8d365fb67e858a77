"""3D-RecGAN's generator as published: what a view shows in, the full shape out.

Source: Yang et al., "3D Object Reconstruction from a Single Depth View with Adversarial Learning", ICCVW 2017, and its
released code.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from training.networks.autoencoder import ConvEncoder, ConvGenerator
from training.networks.physnet import SCALES


@dataclass(frozen=True)
class RecGanConfig:
    """Defaults are the published ones.

    Attributes:
        channels: Of the encoder at 32³, 16³, 8³ and 4³; of the generator in reverse.
        hidden: Numbers of the code between them.
        view_channels: 1 takes what is observed, as published; 2 also what was seen to be free.
    """

    channels: tuple[int, int, int, int] = (64, 128, 256, 512)
    hidden: int = 5000
    view_channels: int = 1


class RecGan(nn.Module):
    """An autoencoder with U-Net skips, without a latent distribution."""

    memory_format = torch.channels_last_3d
    """In which a CPU trains it fastest."""

    def __init__(self, config: RecGanConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = ConvEncoder(config.view_channels, config.channels, config.hidden)
        self.generator = ConvGenerator(config.hidden, config.channels, skips=True, planes=0)

    def forward(self, view: Float[Tensor, "batch 2 64 64 64"]) -> Float[Tensor, "batch 64 64 64"]:
        """Logits. `view` holds 1 where a voxel is observed (channel 0) or free (channel 1)."""
        code, features = self.encoder(view[:, : self.config.view_channels])
        nothing = [view.new_zeros((len(view), 0, size, size, size)) for size in SCALES]
        logits: Tensor = self.generator(code, features, nothing)
        return logits
