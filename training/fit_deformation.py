"""Train the deformation network: read top to bottom, it is the whole story."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Bool
from torch import Tensor
from torch.nn import functional

from training.configs import FitDeformationConfig
from training.data.batches import DeformationBatch, DeformationSet, spread_rows
from training.data.lattice import LatticeBatch, LatticeSet
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
from training.networks.checkpoint import take_weights
from training.networks.deformation import DeformationConfig, DeformationNetwork
from training.networks.physnet import PhysNet
from training.networks.warping import displacement_at, sample_field, smoothed, soft_warp
from training.predict import HALF_VOXEL, peak_ratios, predict, relative_displacements
from training.runs import Run


def fit_deformation(
    data: Path, run: Run, config: FitDeformationConfig, begin_from: Path | None = None, more: Sequence[Path] = ()
) -> None:
    """Train from the start, or from the run's last checkpoint.

    Args:
        data: Finished data set; it alone validates.
        run: Where checkpoints, log and curves go.
        config: All that the run is made of.
        begin_from: As in `fit_reconstruction`.
        more: Finished sets whose training splits are trained on too, all bodies alike; the configuration says so then.

    Raises:
        RunError: The run was begun otherwise, or its loss is no longer finite.
        StoreError: A data set cannot be read.
        ValueError: The lattice is asked for where nothing is corrected, or with a critic.
    """
    prior = isinstance(config.network, DeformationConfig) and config.network.prior
    if config.lattice and (not prior or config.adversary):
        raise ValueError("only a correction of the coarse solve, without a critic, is learned on its lattice")
    training, validation = (DeformationSet.load(data, split, prior) for split in ("train", "validation"))
    if more:
        training = training.joined([DeformationSet.load(folder, "train", prior) for folder in more])
        config = replace(config, more=tuple(Store(folder).about() for folder in more))
    if config.held_out:
        training = training.only(~config.held_out.holds(training))
    if isinstance(config.network, DeformationConfig):
        log_gain = float(np.mean(np.log10(training.peak) - training.condition[:, 6]))
        config = replace(config, network=replace(config.network, log_gain=log_gain))
    torch.manual_seed(config.seed)
    network = build_deformation(config.network)
    network = network.to(memory_format=network.memory_format)  # type: ignore[call-overload]
    if begin_from is not None:
        config = replace(config, begun_from=take_weights(network, begin_from))
        run.say(f"begins with {config.begun_from}")
    drawn = LatticeSet.of(training) if config.lattice else training
    learner = Learner(network, config.optimizer, config.steps)
    adversary = Adversary(config.adversary, config.steps) if config.adversary else None
    parts = learner.parts() | ({"critic": adversary} if adversary else {})
    run.say(f"{len(training)} training and {len(validation)} validation samples")
    for step in training_steps(
        run, config, parts, Store(data).manifest(), lambda: validate(network, validation, config.validation_samples)
    ):
        network.train()
        batch = augmented(drawn.batch_by_body(config.bodies, config.loads, step.rng), step.rng)
        terms, answer = step_losses(network, batch, config, step.rng)
        loss = sum(terms.values(), start=torch.zeros(()))
        step.losses = {name: value.item() for name, value in terms.items()}
        if adversary and isinstance(batch, DeformationBatch) and adversary.learns_at(step.index):
            fake = occupancy_of(network, batch, answer)
            given, condition = batch.rest_of_loads, batch.condition
            step.losses |= adversary.learn(given, condition, fake, batch.deformed)
            if (beta := adversary.beta(step.index)) < 1:
                loss = vae_gan_loss(loss, adversary.loss(given, condition, fake), beta)
        run.check_finite(loss, step.index)
        learner.learn(loss)


def augmented(
    batch: DeformationBatch | LatticeBatch, rng: np.random.Generator
) -> DeformationBatch | LatticeBatch:
    """One of the eight symmetries of the square for the whole batch."""
    for axis in (0, 1):
        if rng.random() < 0.5:
            batch = batch.mirrored(axis)
    return batch.transposed() if rng.random() < 0.5 else batch


def step_losses(
    network: DeformationNetwork | PhysNet, batch: DeformationBatch | LatticeBatch, config: FitDeformationConfig,
    rng: np.random.Generator,
) -> tuple[dict[str, Tensor], Tensor]:  # fmt: skip
    """Weighted terms of L_VAE for one batch, and the network's answer: a correction, or logits."""
    noise = torch.randn(len(batch.condition), config.network.latent)
    if isinstance(network, PhysNet):
        assert isinstance(batch, DeformationBatch), "it corrects nothing"
        answer, mean, log_variance = network(batch.rest, batch.condition, noise)
        terms = {"occupancy": modified_bce_with_logits(answer, batch.deformed, config.alpha)}
    else:
        answer, mean, log_variance = network(batch.rest, batch.condition, noise, batch.prior_forward)
        terms = {"displacement": displacement_loss(batch, answer)}
        if isinstance(batch, DeformationBatch):
            terms["occupancy"] = config.occupancy_weight * occupancy_loss(batch, answer, config, rng)
    return terms | {"kl": config.kl_weight * kl_divergence(mean, log_variance)}, answer


def displacement_loss(batch: DeformationBatch | LatticeBatch, correction: Tensor) -> Tensor:
    """Relative displacement error over the body at rest: it looks nothing up, and costs little for all it sees."""
    moved = batch.prior_forward + correction
    if moved.shape[2:] != batch.forward.shape[2:]:
        moved = functional.interpolate(moved, size=batch.forward.shape[2:], mode="trilinear", align_corners=False)
    covered = batch.rest_coverage.repeat_interleave(len(moved) // len(batch.rest), dim=0)
    return relative_displacement(moved, batch.forward, covered, batch.peak, HALF_VOXEL)


def occupancy_loss(
    batch: DeformationBatch, correction: Tensor, config: FitDeformationConfig, rng: np.random.Generator
) -> Tensor:
    """Cross-entropy of voxels near the surfaces: what is served, forward and back, at a few places for all."""
    voxels, target = sample_voxels(batch, config.points, rng)
    source = voxels - displacement_at(correction, batch.prior_backward, voxels).transpose(1, 2)
    body = smoothed(batch.rest).repeat_interleave(len(source) // len(batch.rest), dim=0)
    occupancy = sample_field(body, source, outside="zeros")[:, 0]
    return modified_bce(occupancy, target, config.alpha)


def occupancy_of(network: DeformationNetwork | PhysNet, batch: DeformationBatch, answer: Tensor) -> Tensor:
    """The probability of every voxel, with a gradient, as a critic judges it."""
    if isinstance(network, PhysNet):
        return answer.sigmoid()
    return soft_warp(batch.rest_of_loads, answer, batch.prior_backward)


def sample_voxels(batch: DeformationBatch, count: int, rng: np.random.Generator) -> tuple[Tensor, Tensor]:
    """Voxel centres to compare at, and what the deformed body has there.

    Three of four are drawn where body and deformed body differ or have their surface, the rest anywhere in the cube.
    """
    rest, deformed = batch.rest[:, 0].numpy() > 0.5, batch.deformed.numpy() > 0.5
    loads = len(deformed) // len(rest)
    chosen = rng.integers(0, deformed[0].size, (len(deformed), count))
    for row, moved in zip(chosen, zip(rest.repeat(loads, axis=0), deformed, strict=True), strict=True):
        band = np.flatnonzero((moved[0] != moved[1]) | _surface(moved[1]))
        row[: 3 * count // 4] = band[rng.integers(0, len(band), 3 * count // 4)]
    index = torch.from_numpy(chosen)
    return _centres(index, deformed.shape[1]), torch.gather(batch.deformed.flatten(1), 1, index)


def _centres(index: Tensor, size: int) -> Tensor:
    return (torch.stack([index // size**2, index // size % size, index % size], dim=2) + 0.5) / size


def _surface(occupancy: Bool[np.ndarray, "x y z"]) -> Bool[np.ndarray, "x y z"]:
    """Voxels that differ from one of their neighbours, on either side."""
    found = np.zeros_like(occupancy)
    for axis in range(3):
        along, of = np.moveaxis(occupancy, axis, 0), np.moveaxis(found, axis, 0)
        differs = along[1:] != along[:-1]
        of[1:] |= differs
        of[:-1] |= differs
    return found


@torch.no_grad()
def validate(network: DeformationNetwork | PhysNet, samples: DeformationSet, count: int) -> dict[str, float]:
    """Figures on a fixed, evenly spread subset, beside the identity baseline; those of displacements if it has any.

    `skill` counts samples that moved (identity IoU below 0.95) and is 0 where none did: nothing was to be gained.
    """
    network.eval()
    rows = spread_rows(len(samples), count)
    ious, means, relative, peaks = [], [], [], []
    for part in np.array_split(rows, max(1, len(rows) // 16)):
        batch = samples.batch(part)
        answer = predict(network, batch)
        predicted = answer.probability > 0.5
        ious += [iou(p, t) for p, t in zip(predicted, batch.deformed.numpy() > 0.5, strict=True)]
        means.append(answer.latent_mean)
        if answer.field is not None:
            relative += list(relative_displacements(answer.field, batch))
            peaks += list(peak_ratios(answer.field, batch))
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
