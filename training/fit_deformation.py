"""Train the deformation network: read top to bottom, it is the whole story."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from training.configs import FitDeformationConfig
from training.data.batches import DeformationBatch, DeformationSet
from training.data.store import Store
from training.fit_critic import Adversary
from training.fit_loop import Learner, training_steps
from training.losses import (
    kl_divergence,
    modified_bce,
    modified_bce_with_logits,
    relative_displacement,
    vae_gan_loss,
)
from training.metrics import active_latents, iou, skill
from training.networks.build import build_deformation
from training.networks.deformation import DeformationConfig, DeformationNetwork, sample_field, soft_warp, warp
from training.networks.physnet import PhysNet
from training.runs import Run

HALF_VOXEL = 0.5 / 64.0


def fit_deformation(data: Path, run: Run, config: FitDeformationConfig) -> None:
    """Train from the start, or from the run's last checkpoint."""
    training, validation = DeformationSet.load(data, "train"), DeformationSet.load(data, "validation")
    if isinstance(config.network, DeformationConfig):
        log_gain = float(np.mean(np.log10(training.peak) - training.condition[:, 6]))
        config = replace(config, network=replace(config.network, log_gain=log_gain))
    torch.manual_seed(config.seed)
    # Channels last: measured 3.2 times faster a step than channels first (oneDNN on two AVX-512 cores).
    network = build_deformation(config.network).to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]
    learner = Learner(network, config.optimizer, config.steps)
    adversary = Adversary(config.adversary, config.steps) if config.adversary else None
    parts = learner.parts() | ({"critic": adversary} if adversary else {})
    run.say(f"{len(training)} training and {len(validation)} validation samples")
    for step in training_steps(
        run, config, parts, Store(data).manifest(), lambda: validate(network, validation, config.validation_samples)
    ):
        network.train()
        batch = augmented(training.batch_by_body(config.bodies, config.loads, step.rng), step.rng)
        terms, answer = step_losses(network, batch, config)
        loss = sum(terms.values(), start=torch.zeros(()))
        step.losses = {name: value.item() for name, value in terms.items()}
        if adversary and adversary.learns_at(step.index):
            fake = occupancy_of(network, batch, answer)
            given, condition = batch.rest_of_loads, batch.condition
            step.losses |= adversary.learn(given, condition, fake, batch.deformed)
            if (beta := adversary.beta(step.index)) < 1:
                loss = vae_gan_loss(loss, adversary.loss(given, condition, fake), beta)
        run.check_finite(loss, step.index)
        learner.learn(loss)


def augmented(batch: DeformationBatch, rng: np.random.Generator) -> DeformationBatch:
    """One of the eight symmetries of the square for the whole batch."""
    for axis in (0, 1):
        if rng.random() < 0.5:
            batch = batch.mirrored(axis)
    return batch.transposed() if rng.random() < 0.5 else batch


def step_losses(
    network: DeformationNetwork | PhysNet, batch: DeformationBatch, config: FitDeformationConfig
) -> tuple[dict[str, Tensor], Tensor]:
    """Weighted terms of L_VAE for one batch, and the network's answer: a field, or logits."""
    noise = torch.randn(len(batch.condition), config.network.latent)
    answer, mean, log_variance = network(batch.rest, batch.condition, noise)
    kl = {"kl": config.kl_weight * kl_divergence(mean, log_variance)}
    if isinstance(network, PhysNet):
        return {"occupancy": modified_bce_with_logits(answer, batch.deformed, config.alpha)} | kl, answer
    points, target = sample_points(batch, config.points)
    source = points - sample_field(answer, points).transpose(1, 2)
    occupancy = sample_field(batch.rest_of_loads, source, outside="zeros")[:, 0]
    field = {
        "displacement": relative_displacement(answer, batch.displacement, batch.coverage, batch.peak, HALF_VOXEL),
        "occupancy": config.occupancy_weight * modified_bce(occupancy, target, config.alpha),
    }
    return field | kl, answer


def occupancy_of(network: DeformationNetwork | PhysNet, batch: DeformationBatch, answer: Tensor) -> Tensor:
    """The probability of every voxel, with a gradient, as a critic judges it."""
    return answer.sigmoid() if isinstance(network, PhysNet) else soft_warp(batch.rest_of_loads, answer)


def sample_points(batch: DeformationBatch, count: int) -> tuple[Tensor, Tensor]:
    """Voxel centres to compare at, and what the deformed body has there.

    Half are drawn where the body was or is, with one voxel around it; the rest anywhere in the cube.
    """
    either = torch.maximum(batch.rest_of_loads[:, 0], batch.deformed)
    near = torch.nn.functional.max_pool3d(either[:, None], 3, stride=1, padding=1)[:, 0].flatten(1)
    weight = near / near.sum(dim=1, keepdim=True) + 1.0 / near.shape[1]
    index = torch.multinomial(weight, count, replacement=True)
    target = torch.gather(batch.deformed.flatten(1), 1, index)
    size = batch.deformed.shape[1]
    grid = torch.stack([index // (size * size), index // size % size, index % size], dim=2)
    return (grid + 0.5) / size, target


@torch.no_grad()
def validate(network: DeformationNetwork | PhysNet, samples: DeformationSet, count: int) -> dict[str, float]:
    """Figures on a fixed, evenly spread subset, beside the identity baseline; those of displacements if it has any.

    `skill` counts samples that moved (identity IoU below 0.95) and is 0 where none did: nothing was to be gained.
    """
    network.eval()
    rows = np.unique(np.linspace(0, len(samples) - 1, count).astype(int))
    ious, means, relative, peaks = [], [], [], []
    for part in np.array_split(rows, max(1, len(rows) // 16)):
        batch = samples.batch(part)
        answer, mean, _ = network(batch.rest, batch.condition, torch.zeros(len(part), network.config.latent))
        is_field = not isinstance(network, PhysNet)
        predicted = ((warp(batch.rest, answer) if is_field else answer.sigmoid()) > 0.5).numpy()
        ious += [iou(p, t) for p, t in zip(predicted, batch.deformed.numpy() > 0.5, strict=True)]
        means.append(mean.numpy())
        for i in range(len(part) if is_field else 0):
            one = slice(i, i + 1)
            relative.append(
                float(relative_displacement(answer[one], batch.displacement[one], batch.coverage[one],
                                            batch.peak[one], HALF_VOXEL))
            )  # fmt: skip
            inside = batch.coverage[i, 0] > 0
            peaks.append(float(answer[i].norm(dim=0)[inside].max() / batch.peak[i]))
    scores, identity = np.array(ious), samples.identity_iou[rows].astype(float)
    large = identity < 0.95
    figures = {
        "iou": float(scores.mean()),
        "identity": float(identity.mean()),
        "skill": float(skill(scores[large], identity[large]).mean()) if large.any() else 0.0,
        "active_latents": float(active_latents(np.concatenate(means))),
    }
    if relative:
        figures |= {"displacement_error": float(np.mean(relative)), "peak_ratio": float(np.median(peaks))}
    return figures
