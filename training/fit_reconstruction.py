"""Train the reconstruction network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from training.configs import FitReconstructionConfig
from training.data.batches import ViewSet, spread_rows
from training.data.store import Store
from training.fit_critic import Adversary
from training.fit_loop import Learner, training_steps
from training.losses import occupancy_losses, vae_gan_loss
from training.metrics import iou
from training.networks.build import build_reconstruction
from training.networks.checkpoint import take_weights
from training.networks.recgan import RecGan
from training.networks.reconstruction import ReconstructionNetwork
from training.networks.restored import take_served_weights
from training.runs import Run

MEASURED_VIEWS = 256
"""By which the normalisations of an exported model are measured anew."""


def fit_reconstruction(
    data: Path, run: Run, config: FitReconstructionConfig, begin_from: Path | None = None, more: Sequence[Path] = ()
) -> None:
    """Train from the start, or from the run's last checkpoint.

    Args:
        data: The views; they alone validate.
        run: Where checkpoints go.
        config: All that it is made of.
        begin_from: Checkpoint of another run to begin with, as far as its weights fit, or folder of an exported model;
            the configuration says so then.
        more: Finished sets whose training splits are trained on too, all views alike; the configuration says so then.

    Raises:
        RunError: No weight of that checkpoint fits, or the run was begun with another configuration or data set.
    """
    training, validation = ViewSet.load(data, "train"), ViewSet.load(data, "validation")
    if more:
        training = training.joined([ViewSet.load(folder, "train") for folder in more])
        config = replace(config, more=tuple(Store(folder).about() for folder in more))
    torch.manual_seed(config.seed)
    network = build_reconstruction(config.network)
    # Channels last: measured 3.2 times faster a step than channels first (oneDNN on two AVX-512 cores).
    if begin_from is not None:
        config = replace(config, begun_from=_take(network, begin_from, training))
        run.say(f"begins with {config.begun_from}")
    network = network.to(memory_format=network.memory_format)  # type: ignore[call-overload]
    learner = Learner(network, config.optimizer, config.steps)
    adversary = Adversary(config.adversary, config.steps) if config.adversary else None
    parts = learner.parts() | ({"critic": adversary} if adversary else {})
    run.say(f"{len(training)} training and {len(validation)} validation views")
    for step in training_steps(
        run, config, parts, Store(data).manifest(), lambda: validate(network, validation, config.validation_samples)
    ):
        network.train()
        rows = step.rng.choice(len(training), config.batch, replace=False)
        if config.augmentation is None:
            batch = training.batch(rows)
        else:
            batch = training.augmented_batch(rows, config.augmentation, step.rng)
        if step.rng.random() < 0.5:
            batch = batch.mirrored()
        with torch.autocast("cpu", torch.bfloat16, enabled=config.bfloat16):
            logits = network(batch.view)
        logits = logits.float()
        # What noise carried into the body where the camera saw nothing costs the same whatever is said there.
        free = (batch.view[:, 1] > 0.5) if config.overrule else torch.zeros_like(logits, dtype=torch.bool)
        entropy, overlap = occupancy_losses(logits, batch.truth, free, config.alpha)
        step.losses = {"bce": entropy.item(), "soft_iou": 1 - overlap.item()}
        loss = entropy + config.iou_weight * overlap
        if adversary and adversary.learns_at(step.index):
            given = batch.view[:, : adversary.config.critic.given_channels]
            fake = logits.sigmoid().masked_fill(free, 0.0)
            step.losses |= adversary.learn(given, None, fake, batch.truth)
            if (beta := adversary.beta(step.index)) < 1:
                loss = vae_gan_loss(loss, adversary.loss(given, None, fake), beta)
        run.check_finite(loss, step.index)
        learner.learn(loss)


def _take(network: ReconstructionNetwork | RecGan, begin_from: Path, views: ViewSet) -> str:
    """Begin with a checkpoint's weights, or with those of an exported model."""
    if not begin_from.is_dir():
        return take_weights(network, begin_from)
    if not isinstance(network, ReconstructionNetwork):
        raise ValueError(f"{begin_from} is a model that is served; only the networks that are served begin with one")
    rows = spread_rows(len(views), MEASURED_VIEWS)
    parts = np.array_split(rows, max(1, len(rows) // 8))
    return take_served_weights(network, begin_from, (views.batch(part).view for part in parts))


@torch.no_grad()
def validate(network: ReconstructionNetwork | RecGan, views: ViewSet, count: int) -> dict[str, float]:
    """IoU on a fixed, evenly spread subset, beside what is observed alone."""
    network.eval()
    rows = spread_rows(len(views), count)
    ious, seen = [], []
    for part in np.array_split(rows, max(1, len(rows) // 16)):
        batch = views.batch(part)
        observed, free = batch.view[:, 0].numpy() > 0.5, batch.view[:, 1].numpy() > 0.5
        filled = (network(batch.view) > 0).numpy() & ~free
        truth = batch.truth.numpy() > 0.5
        ious += [iou(p, t) for p, t in zip(filled, truth, strict=True)]
        seen += [iou(o, t) for o, t in zip(observed, truth, strict=True)]
    return {"iou": float(np.mean(ious)), "observed_only": float(np.mean(seen))}
