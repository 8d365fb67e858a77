"""A body looked up through displacement fields, with a gradient: what `service.core` serves, for a loss to judge."""

from __future__ import annotations

from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn import functional

from service.core.smoothing import SURE
from training.networks.blocks import cell_centres


def sample_field(
    field: Float[Tensor, "batch c x y z"],
    points: Float[Tensor, "batch n 3"],
    outside: Literal["border", "zeros"] = "border",
) -> Float[Tensor, "batch c n"]:
    """Trilinear lookup of a field over the unit cube, differentiable in both.

    Args:
        field: Values at the centres of a regular lattice.
        points: Where to look; x, y, z in [0, 1] inside the cube.
        outside: `border` holds the last value, as for a displacement; `zeros` falls to nothing, as for a body.

    torch's grid_sample indexes the last axis first, hence the flip.
    """
    grid = (2.0 * points - 1.0).flip(-1)[:, :, None, None, :]
    sampled = functional.grid_sample(field, grid, mode="bilinear", padding_mode=outside, align_corners=False)
    return sampled[:, :, :, 0, 0]


def displacement_at(
    correction: Float[Tensor, "batch 3 16 16 16"],
    backward: Float[Tensor, "batch 3 32 32 32"],
    points: Float[Tensor, "batch n 3"],
) -> Float[Tensor, "batch 3 n"]:
    """Backward displacement at places of the deformed body, with a gradient in the correction.

    Args:
        correction: The network's.
        backward: u_b of the coarse solve; zeros without one, when the correction is all there is.
        points: x, y, z in edges of the grid.

    Source: `service.core.displacement.corrected`, which serves.
    """
    moved = sample_field(correction, points - sample_field(backward, points).transpose(1, 2))
    return moved + sample_field(backward, points - moved.transpose(1, 2))


def smoothed(occupancy: Float[Tensor, "bodies 1 64 64 64"]) -> Float[Tensor, "bodies 1 64 64 64"]:
    """`service.core.smoothing.smoothed` of a batch."""
    values = occupancy
    for axis in (2, 3, 4):
        size = values.shape[axis]
        mean = 0.5 * values
        mean.narrow(axis, 1, size - 1).add_(values.narrow(axis, 0, size - 1), alpha=0.25)
        mean.narrow(axis, 0, size - 1).add_(values.narrow(axis, 1, size - 1), alpha=0.25)
        if axis == 4:
            mean.narrow(axis, 0, 1).add_(values.narrow(axis, 0, 1), alpha=0.25)
        values = mean
    return torch.where(occupancy > 0.5, values.clamp(min=0.5 + SURE), values.clamp(max=0.5 - SURE))


def soft_warp(
    rest: Float[Tensor, "loads 1 64 64 64"],
    correction: Float[Tensor, "loads 3 16 16 16"],
    backward: Float[Tensor, "loads 3 32 32 32"],
) -> Float[Tensor, "loads 64 64 64"]:
    """Deformed occupancy with a gradient in the correction, for a critic to judge."""
    points = cell_centres(64, correction).flatten(1).T.expand(len(correction), -1, -1)
    source = points - displacement_at(correction, backward, points).transpose(1, 2)
    return sample_field(smoothed(rest), source, outside="zeros").reshape(-1, 64, 64, 64)
