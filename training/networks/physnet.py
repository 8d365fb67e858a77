"""3D-PhysNet's generator as published, and the IcGAN baseline that the paper holds against it.

E encodes the undeformed body into the normal distribution of a latent, G decodes a sample of it and the condition into
the occupancy of the deformed body. The baseline has the same convolutions and a plain code in the latent's place.

Source: 3D-PhysNet, sections 3.2 and 4.3 and Table 1; IcGAN: Perarnau et al., arXiv 1611.06355.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor, nn

from training.networks.autoencoder import ConvEncoder, ConvGenerator
from training.networks.conditions import ConditionConfig

SCALES = (32, 16, 8, 4)


@dataclass(frozen=True)
class PhysNetConfig:
    """Defaults are the paper's.

    Attributes:
        channels: Of the encoder at 32³, 16³, 8³ and 4³; of the generator in reverse.
        hidden: Numbers after the encoder's dense layer.
        latent: Of μ and of σ; without a variational latent the code of `hidden` numbers is used as it is.
        variational: False for the IcGAN baseline.
        skips: U-Net concatenation.
        conditioned: False for the ablation that never learns of the load.
        condition: Encoding of the load.
    """

    channels: tuple[int, int, int, int] = (64, 128, 256, 512)
    hidden: int = 5000
    latent: int = 800
    variational: bool = True
    skips: bool = True
    conditioned: bool = True
    condition: ConditionConfig = field(default_factory=lambda: ConditionConfig(encoding="real"))


class PhysNet(nn.Module):
    """E and G; `rest` is one body, `condition` holds any number of loads on it (or one body for each)."""

    memory_format = torch.channels_last_3d
    """In which a CPU trains it fastest: 3.2 times as fast as channels first (oneDNN on two AVX-512 cores)."""

    def __init__(self, config: PhysNetConfig) -> None:
        super().__init__()
        self.config = config
        self.encoder = ConvEncoder(1, config.channels, config.hidden)
        if config.variational:
            self.mean = nn.Linear(config.hidden, config.latent)
            self.log_variance = nn.Linear(config.hidden, config.latent)
        code = config.latent if config.variational else config.hidden
        self.generator = ConvGenerator(
            code + config.condition.width, config.channels, config.skips, config.condition.planes
        )

    def forward(
        self,
        rest: Float[Tensor, "bodies 1 64 64 64"],
        condition: Float[Tensor, "loads fields"],
        noise: Float[Tensor, "loads latent"],
    ) -> tuple[Float[Tensor, "loads 64 64 64"], Tensor, Tensor]:
        """Logits of the deformed occupancy, and μ, log σ² of the latent (the code and zeros where it is plain).

        Args:
            rest: Undeformed occupancy; the loads are divided evenly among the bodies, in order.
            condition: As the configuration's encoding takes it.
            noise: Standard normal for a sample of the posterior, zeros for its mean; a plain code ignores it.
        """
        each = len(condition) // len(rest)
        mean, log_variance, features = self.encode(rest)
        z, log_variance = mean.repeat_interleave(each, dim=0), log_variance.repeat_interleave(each, dim=0)
        if self.config.variational:
            z = reparametrised(z, log_variance, noise)
        features = [f.repeat_interleave(each, dim=0) for f in features]
        if not self.config.conditioned:
            condition = torch.zeros_like(condition)
        planes = [self.config.condition.fields(condition, size) for size in SCALES]
        code = torch.cat([z, self.config.condition.encoded(condition)], dim=1)
        return self.generator(code, features, planes), mean.repeat_interleave(each, dim=0), log_variance

    def encode(self, rest: Float[Tensor, "bodies 1 64 64 64"]) -> tuple[Tensor, Tensor, list[Tensor]]:
        """E: μ and log σ² of every body, and the features that skip the latent."""
        hidden, features = self.encoder(rest)
        if not self.config.variational:
            return hidden, torch.zeros_like(hidden), features
        return self.mean(hidden), self.log_variance(hidden), features


def reparametrised(mean: Tensor, log_variance: Tensor, noise: Tensor) -> Tensor:
    """Z = μ + σ ε. Source: Kingma and Welling, "Auto-Encoding Variational Bayes", ICLR 2014, eq. 10."""
    return mean + torch.exp(0.5 * log_variance) * noise
