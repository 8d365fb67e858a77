"""The losses, one function an equation.

Source: 3D-PhysNet, section 3 (the paper), unless a function names another.
"""

from __future__ import annotations

import torch
from jaxtyping import Float
from torch import Tensor

OUTPUT_CLAMP = 0.01
"""Probabilities are kept this far from 0 and 1 in the cross-entropy. Source: the authors' released code."""


def modified_bce(output: Float[Tensor, "*shape"], target: Float[Tensor, "*shape"], alpha: float) -> Tensor:
    """L_ae = mean(-α t log o - (1-α)(1-t) log(1-o)).

    Args:
        output: Occupancy probability, clamped to [0.01, 0.99].
        target: 0 or 1.
        alpha: Weight of missed voxels against false ones; the authors' 0.85 fills generously and is read off at a
            threshold of 0.8, 0.5 is the plain cross-entropy up to a factor of two.
    """
    o = output.clamp(OUTPUT_CLAMP, 1.0 - OUTPUT_CLAMP)
    return -(alpha * target * torch.log(o) + (1 - alpha) * (1 - target) * torch.log(1 - o)).mean()


def modified_bce_with_logits(logits: Float[Tensor, "*shape"], target: Float[Tensor, "*shape"], alpha: float) -> Tensor:
    """The same on logits, without the clamp (the logarithm of the sigmoid is exact)."""
    log_o = torch.nn.functional.logsigmoid(logits)
    log_not_o = torch.nn.functional.logsigmoid(-logits)
    return -(alpha * target * log_o + (1 - alpha) * (1 - target) * log_not_o).mean()


def kl_divergence(mean: Float[Tensor, "batch latent"], log_variance: Float[Tensor, "batch latent"]) -> Tensor:
    """L_prior = D_KL(N(μ, σ²) ‖ N(0, I)), summed over the latent, averaged over the batch, in nats.

    Source: Kingma and Welling, "Auto-Encoding Variational Bayes", ICLR 2014, appendix B.
    """
    return 0.5 * (mean**2 + log_variance.exp() - 1 - log_variance).sum(dim=1).mean()


def relative_displacement(
    predicted: Float[Tensor, "batch 3 x y z"],
    target: Float[Tensor, "batch 3 x y z"],
    weight: Float[Tensor, "batch 1 x y z"],
    peak: Float[Tensor, "batch"],
    floor: float,
) -> Tensor:
    """Mean over the body of |u - û| as a share of the sample's peak displacement.

    Args:
        predicted: û in edges of the grid.
        target: u likewise.
        weight: Share of each node's cell that lies in the deformed body.
        peak: Largest |u| of the sample.
        floor: Peaks below this count as this: below a fraction of a voxel nobody can see the difference.
    """
    distance = torch.sqrt(((predicted - target) ** 2).sum(dim=1, keepdim=True) + 1e-12)
    mean = (distance * weight).sum(dim=(1, 2, 3, 4)) / weight.sum(dim=(1, 2, 3, 4)).clamp(min=1.0)
    return (mean / peak.clamp(min=floor)).mean()
