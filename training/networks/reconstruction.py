"""3D-RecGAN's generator for a CPU: what a view says about 64³ voxels in, the full shape out.

The view grid stands on the support plane with z up, so a voxel's height means the same in every view. The network
therefore takes the 64 voxels of a vertical column as channels and convolves over the ground plane only, as over a map
whose pixels hold profiles. Convolutions of planes are what CPUs do best, twice as fast as those of space.

Source: Yang et al., "3D Object Reconstruction from a Single Depth View with Adversarial Learning", ICCVW 2017.
"""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor, nn

from training.networks.blocks import LEAKY_SLOPE, PlaneBlock, ResidualPlaneBlock, Stem

SIZE = 64


@dataclass(frozen=True)
class ReconstructionConfig:
    """Channels and residual blocks at 32², 16², 8² and 4².

    Attributes:
        channels: On the way down and up.
        blocks: Residual blocks on the way down; up there is one at each size.
        detail: Features of every single column, through which the view reaches the answer at full resolution.
        silent: Whether residual blocks say nothing at first, see `ResidualPlaneBlock`.
    """

    channels: tuple[int, int, int, int] = (48, 128, 192, 224)
    blocks: tuple[int, int, int, int] = (1, 2, 2, 2)
    detail: int = 32
    silent: bool = False


class Finer(nn.Module):
    """Twice the resolution: every pixel speaks for its four parts."""

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        self.conv = nn.Conv2d(inputs, 4 * outputs, 1)

    def forward(self, x: Float[Tensor, "batch inputs x y"]) -> Float[Tensor, "batch outputs width depth"]:
        return spoken(x.permute(0, 2, 3, 1), self.conv).permute(0, 3, 1, 2)


def spoken(x: Float[Tensor, "batch x y inputs"], conv: nn.Conv2d) -> Float[Tensor, "batch width depth outputs"]:
    """What every pixel says of its four parts by a 1² convolution. Channels lie last.

    The answers for a pixel's parts stand next to each other in the weights, as in PyTorch's pixel shuffle; with the
    part put first, all that is said of it is carried to its place in one piece.
    """
    batch, width, depth, _ = x.shape
    outputs = conv.out_channels // 4
    weight = conv.weight.reshape(outputs, 4, -1).transpose(0, 1).flatten(0, 1)
    bias = None if conv.bias is None else conv.bias.reshape(outputs, 4).T.flatten()
    parts = nn.functional.linear(x, weight, bias).reshape(batch, width, depth, 2, 2, outputs)
    return parts.permute(0, 1, 3, 2, 4, 5).reshape(batch, 2 * width, 2 * depth, outputs)


class ReconstructionNetwork(nn.Module):
    """U-Net from (observed, free) to the logit of occupancy of every voxel."""

    memory_format = torch.channels_last
    """In which a CPU trains it fastest."""

    def __init__(self, config: ReconstructionConfig) -> None:
        super().__init__()
        self.config = config
        inputs = (2 * SIZE, *config.channels)
        self.down = nn.ModuleList(
            nn.Sequential(
                Stem(coming, going, 2) if level == 0 else PlaneBlock(coming, going, 2, 2),
                *[ResidualPlaneBlock(going, config.silent) for _ in range(blocks)],
            )
            for level, (coming, going, blocks) in enumerate(zip(inputs, config.channels, config.blocks, strict=False))
        )
        pairs = list(zip(config.channels[1:], config.channels, strict=False))[::-1]
        self.up = nn.ModuleList(Finer(coarse, fine) for coarse, fine in pairs)
        self.merge = nn.ModuleList(
            nn.Sequential(PlaneBlock(2 * fine, fine, 1), ResidualPlaneBlock(fine, config.silent)) for _, fine in pairs
        )
        self.head = nn.Sequential(nn.Conv2d(config.channels[0], 4 * SIZE, 1))
        self.seen = nn.Linear(2 * SIZE, config.detail)
        self.spread = nn.Conv2d(config.channels[0], 4 * config.detail, 1, bias=False)
        self.activation = nn.LeakyReLU(LEAKY_SLOPE)
        self.detail = nn.Linear(config.detail, SIZE, bias=False)
        nn.init.zeros_(self.detail.weight)  # the coarse features answer first

    def forward(
        self, view: Float[Tensor, "batch 2 64 64 64"], told: Callable[[Tensor], Tensor] = lambda x: x
    ) -> Float[Tensor, "batch 64 64 64"]:
        """Logits.

        Args:
            view: 1 where a voxel is observed (channel 0) or free (channel 1).
            told: What the features become at each of seven sizes, 32² to 4² and back, where they are told of more.
        """
        columns = view.permute(0, 2, 3, 1, 4).flatten(3)
        x: Tensor = columns
        passed = []
        for down in self.down:
            x = told(down(x))
            passed.append(x)
        passed.pop()
        for up, merge in zip(self.up, self.merge, strict=True):
            x = told(merge(torch.cat([up(x), passed.pop()], dim=1)))
        x = x.permute(0, 2, 3, 1)
        column = self.activation(self.seen(columns) + spoken(x, self.spread))
        (head,) = self.head
        assert isinstance(head, nn.Conv2d)
        logits: Tensor = spoken(x, head) + self.detail(column)
        return logits


def tempered(network: ReconstructionNetwork, temperature: float) -> ReconstructionNetwork:
    """A copy whose logits are divided by a temperature: less sure above 1, of the same opinion at one half.

    Source: Guo et al., "On Calibration of Modern Neural Networks", ICML 2017, section 4.2.
    """
    copied = copy.deepcopy(network)
    for layer in (copied.head, copied.detail):
        for parameter in layer.parameters():
            parameter.data /= temperature
    return copied
