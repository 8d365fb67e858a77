"""The losses, one function an equation.

Source: 3D-PhysNet, section 3 (the paper), unless a function names another.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import torch
from jaxtyping import Bool, Float
from torch import Tensor

OUTPUT_CLAMP = 0.01
"""Probabilities are kept this far from 0 and 1 in the cross-entropy. Source: the authors' released code."""

EVEN = 0.5
"""The α that weighs missed and false voxels alike."""


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
    minus_log_not_o = torch.nn.functional.softplus(logits)  # and -log o is this less the logit: one pass in two's place
    weight = 1 - alpha + (2 * alpha - 1) * target
    return (weight * minus_log_not_o - alpha * target * logits).mean()


def soft_iou_loss(logits: Float[Tensor, "batch *grid"], target: Float[Tensor, "batch *grid"]) -> Tensor:
    """1 - Σ o t / Σ (o + t - o t) of every sample, averaged: what is measured, made differentiable.

    Source: Rahman and Wang, "Optimizing Intersection-Over-Union in Deep Neural Networks for Image Segmentation", ISVC
    2016, eq. 3.
    """
    o, t = logits.sigmoid().flatten(1), target.flatten(1)
    both = (o * t).sum(dim=1)
    either = o.sum(dim=1) + t.sum(dim=1) - both
    return (1 - both / either.clamp(min=1e-6)).mean()


def occupancy_losses(
    logits: Float[Tensor, "batch *grid"],
    target: Float[Tensor, "batch *grid"],
    free: Bool[Tensor, "batch *grid"],
    alpha: float,
) -> tuple[Tensor, Tensor]:
    """`modified_bce_with_logits` and `soft_iou_loss` of the voxels that are not free, at half their price.

    Left to torch the two keep a dozen tensors of 64³ voxels a view, and cost a third of a small network's step.

    Args:
        logits: Of occupancy.
        target: 0 or 1.
        free: Where a voxel counts as empty whatever is said, and costs nothing.
        alpha: As in `modified_bce`.
    """
    entropy, overlap = _OccupancyLosses.apply(logits, target, free, alpha)  # type: ignore[no-untyped-call]
    return entropy, overlap


class _OccupancyLosses(torch.autograd.Function):
    """Both losses with their slopes written out."""

    @staticmethod
    def forward(ctx: Any, logits: Tensor, target: Tensor, free: Tensor, alpha: float) -> tuple[Tensor, Tensor]:
        output = logits.sigmoid().masked_fill_(free, 0.0)
        target = target.masked_fill(free, 0.0)
        flat, wanted = output.flatten(1), target.flatten(1)
        both = torch.linalg.vecdot(flat, wanted)
        either = (flat.sum(dim=1) + wanted.sum(dim=1) - both).clamp_(min=1e-6)
        likelihood = (output + target).sub_(1.0).abs_().clamp_(min=1e-7).log_()
        if alpha != EVEN:
            likelihood *= (1 - alpha) + (2 * alpha - 1) * target
        entropy = -likelihood.mean() * (EVEN if alpha == EVEN else 1.0)
        ctx.save_for_backward(output, target, both, either)
        ctx.alpha = alpha
        return entropy, (1 - both / either).mean()

    @staticmethod
    def backward(ctx: Any, *slopes: Tensor) -> tuple[Tensor | None, ...]:
        """Slope of the logits: of the entropy (1-α)(1-t) o - α t (1-o), of the overlap by the quotient rule."""
        output, target, both, either = ctx.saved_tensors
        of_entropy, of_overlap = slopes
        each = (-1, *[1] * (output.ndim - 1))
        scale = of_overlap / len(output) / either**2
        slope = torch.addcmul((scale * both).view(each), target, (-scale * (both + either)).view(each))
        slope.mul_(output).mul_(1 - output)
        scale = of_entropy / output.numel()
        if ctx.alpha == EVEN:
            slope.add_((output - target).mul_(EVEN * scale))
        else:
            weight = (1 - ctx.alpha) + (2 * ctx.alpha - 1) * target
            slope.add_((weight * output - ctx.alpha * target).mul_(scale))
        return slope, None, None, None


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


def vae_gan_loss(vae: Tensor, adversarial: Tensor, beta: float) -> Tensor:
    """L_g = β L_VAE + (1-β) L_gan^g. Source: the paper, section 3.2; the released code's β is 0.95."""
    return beta * vae + (1 - beta) * adversarial


def beta_at(step: int, start: int, ramp: int, beta: float) -> float:
    """β of a step: 1 up to `start`, then down to `beta` in a straight line over `ramp` steps.

    The paper says that the VAE loss matters in the first phase of training and the GAN loss for what is subtle: a
    critic of shapeless blobs has nothing to teach.
    """
    share = min(max(step - start, 0) / max(ramp, 1), 1.0)
    return 1.0 - share * (1.0 - beta)


def generator_adversarial_loss(similarity_fake: Float[Tensor, "batch similarities"]) -> Tensor:
    """L_gan^g = -E[D(o|x)], the mean over batch and similarity vector. Source: the paper, section 3.2."""
    return -similarity_fake.mean()


def wasserstein_loss(
    similarity_fake: Float[Tensor, "batch similarities"], similarity_true: Float[Tensor, "batch similarities"]
) -> Tensor:
    """E[D(o|x)] - E[D(t|x)]: minus the distance between generated and true. Source: the paper, eq. 3."""
    return similarity_fake.mean() - similarity_true.mean()


def gradient_penalty(
    critic: Callable[[Tensor], Tensor],
    fake: Float[Tensor, "batch x y z"],
    true: Float[Tensor, "batch x y z"],
    share: Float[Tensor, " batch"],
) -> Tensor:
    """E[(‖∇_ô D(ô|x)‖₂ - 1)²] at ô = η t + (1-η) o; multiply by λ.

    Args:
        critic: o to D(o|x), a vector of similarities a sample; its mean is the critic's value.
        fake: o.
        true: t.
        share: η in [0, 1] of every sample.

    Source: Gulrajani et al., "Improved Training of Wasserstein GANs", NeurIPS 2017, eq. 3; the paper, eq. 3.
    """
    between = (share[:, None, None, None] * true + (1 - share[:, None, None, None]) * fake).detach()
    between.requires_grad_(True)
    value = critic(between).mean(dim=1).sum()  # samples don't meet in the critic: one gradient serves all
    (gradient,) = torch.autograd.grad(value, between, create_graph=True)
    # The root's slope is infinite at zero, where a critic that knows nothing yet starts.
    length = torch.sqrt((gradient * gradient).sum(dim=(1, 2, 3)) + 1e-12)
    return ((length - 1) ** 2).mean()
