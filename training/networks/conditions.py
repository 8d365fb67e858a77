"""How a material and a load enter a network: as numbers beside the latent, and as fields over the grid.

Three encodings of the served condition (`service.core.condition`): `spatial` is ours, `real` and `one_hot` are the
paper's, section 3.5 and 4.3.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import torch
from jaxtyping import Float
from torch import Tensor

from service.core.condition import CONDITION_FIELDS
from training.networks.blocks import cell_centres

Encoding: TypeAlias = Literal["spatial", "real", "one_hot"]

PLANES = 11
"""Channels of `condition_planes`."""

PLACES = 10
"""Places of the one-hot location along each axis. Source: the paper's ten points along the top, section 4.1."""

SERVED_CENTRE = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -3.0, 0.0, 0.0)
SERVED_SCALE = (2.0, 2.0, 2.0, 1.0, 1.0, 1.0, 1.0, 4.0, 10.0)
"""(condition − centre)·scale is of order one for what a robot asks."""


@dataclass(frozen=True)
class ConditionConfig:
    """What a condition is and how it is encoded.

    Attributes:
        encoding: `spatial` shows the load as fields at every scale of the generator; `real` gives every field as a
            number; `one_hot` gives the contact as one of ten places along each axis, the rest as numbers.
        centre: Subtracted from the fields; as many as the condition has.
        scale: Multiplied with what is left.

    Raises:
        ValueError: `spatial` or `one_hot` of a condition that is not the served one: they need to know which of its
            fields are the contact, the direction and the patch radius.
    """

    encoding: Encoding = "spatial"
    centre: tuple[float, ...] = SERVED_CENTRE
    scale: tuple[float, ...] = SERVED_SCALE

    def __post_init__(self) -> None:
        if len(self.centre) != len(self.scale):
            raise ValueError(f"{len(self.centre)} centres for {len(self.scale)} scales")
        if self.encoding != "real" and len(self.centre) != len(CONDITION_FIELDS):
            raise ValueError(
                f"the {self.encoding} encoding needs the {len(CONDITION_FIELDS)} fields of the served condition, "
                f"not {len(self.centre)}; choose real"
            )

    @property
    def width(self) -> int:
        """Numbers of `encoded`."""
        return 3 * PLACES + len(self.centre) - 3 if self.encoding == "one_hot" else len(self.centre)

    @property
    def planes(self) -> int:
        """Channels of `fields`."""
        return PLANES if self.encoding == "spatial" else 0

    def encoded(self, condition: Float[Tensor, "batch fields"]) -> Float[Tensor, "batch width"]:
        """The numbers that stand beside the latent."""
        numbers = (condition - condition.new_tensor(self.centre)) * condition.new_tensor(self.scale)
        if self.encoding == "one_hot":
            return torch.cat([one_hot_contact(condition[:, :3]), numbers[:, 3:]], dim=1)
        return numbers

    def fields(self, condition: Float[Tensor, "batch fields"], size: int) -> Float[Tensor, "batch planes x y z"]:
        """The channels that stand beside the features of a `size`³ lattice; none but for `spatial`."""
        if self.encoding == "spatial":
            return condition_planes(condition, size)
        return condition.new_zeros((len(condition), 0, size, size, size))


def one_hot_contact(contact: Float[Tensor, "batch axis=3"]) -> Float[Tensor, "batch places"]:
    """Each coordinate (0 to 1) as the one of ten intervals that it falls into.

    Source: the paper, section 4.3, for ten places along one axis.
    """
    place = (contact * PLACES).long().clamp(0, PLACES - 1)
    return torch.nn.functional.one_hot(place, PLACES).to(contact.dtype).flatten(1)


def condition_planes(condition: Float[Tensor, "batch 9"], size: int) -> Float[Tensor, "batch 11 x y z"]:
    """The load as seen from each cell of a `size`³ lattice (the `spatial` encoding).

    Channels: patch weight exp(-r²/2R²); R/√(r²+R²); the direction (3); the vector from the contact (3); the
    displacement of an infinite incompressible body under a regularised point force (3), times R.

    Source: regularised Kelvinlet, de Goes and James, ACM TOG 36(4), 2017, eq. 6, at ν = ½ up to a constant.
    """
    centres = cell_centres(size, condition)
    # not by None: an exported graph would make an operator of each
    contact, direction = condition[:, 0:3].reshape(-1, 3, 1, 1, 1), condition[:, 3:6].reshape(-1, 3, 1, 1, 1)
    radius = condition[:, 8].reshape(-1, 1, 1, 1, 1)
    offset = centres[None] - contact
    squared = (offset * offset).sum(dim=1, keepdim=True)
    patch = torch.exp(-squared / (2 * radius * radius))
    decay = radius * torch.rsqrt(squared + radius * radius)
    along = (offset * direction).sum(dim=1, keepdim=True)
    kelvinlet = direction * decay * (1 + 0.5 * decay * decay) + offset * along * decay**3 / (radius * radius)
    return torch.cat([patch, decay, direction.expand_as(offset), offset, kelvinlet], dim=1)


def slab_channels(width: int, size: int) -> int:
    """Channels that `condition_slabs` needs: one, unless there are more numbers than planes."""
    return -(-width // size)


def condition_slabs(encoded: Float[Tensor, "batch width"], size: int) -> Float[Tensor, "batch c x y z"]:
    """A channel whose planes along x hold the numbers of the condition in turn, each as a slab of equal thickness.

    Source: the paper, section 3.3 ("the condition is reshaped so that it can be concatenated with the voxel grid"),
    and the authors' released code.
    """
    width = encoded.shape[1]
    channels = slab_channels(width, size)
    number = torch.arange(channels * size, device=encoded.device) * width // (channels * size)
    planes = encoded[:, number].reshape(-1, channels, size, 1, 1)
    return planes.expand(-1, -1, size, size, size)
