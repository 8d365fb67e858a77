"""Train the reconstruction network."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from training.data.batches import ViewSet
from training.data.store import Store
from training.losses import modified_bce_with_logits
from training.metrics import iou
from training.networks.reconstruction import ReconstructionConfig, ReconstructionNetwork
from training.runs import Run


@dataclass(frozen=True)
class FitReconstructionConfig:
    """All that a run is made of; saved in every checkpoint."""

    network: ReconstructionConfig = field(default_factory=ReconstructionConfig)
    seed: int = 0
    batch: int = 16
    steps: int = 2000
    learning_rate: float = 1e-3
    warm_up: int = 200
    weight_decay: float = 1e-4
    alpha: float = 0.5
    validate_every: int = 500
    validation_samples: int = 200


def fit_reconstruction(data: Path, run: Run, config: FitReconstructionConfig) -> None:
    """Train from the start, or from the run's last checkpoint."""
    training, validation = ViewSet.load(data, "train"), ViewSet.load(data, "validation")
    torch.manual_seed(config.seed)
    # Channels last: measured 3.2 times faster a step than channels first (oneDNN on two AVX-512 cores).
    network = ReconstructionNetwork(config.network).to(memory_format=torch.channels_last_3d)  # type: ignore[call-overload]
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=config.learning_rate, betas=(0.9, 0.99), weight_decay=config.weight_decay
    )
    rise = min(config.warm_up / config.steps, 0.5)  # a run shorter than its warm-up is a trial, not an error
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, config.learning_rate, total_steps=config.steps, pct_start=rise
    )
    first = run.resume(network, optimizer, schedule, config, dataset=Store(data).manifest())
    run.say(f"{len(training)} training and {len(validation)} validation views")
    network.train()
    started = time.monotonic()
    for step in range(first, config.steps):
        # Everything random of a step comes from (seed, step): a resumed run repeats what an unbroken one does.
        rng = np.random.default_rng((config.seed, step))
        batch = training.batch(rng.choice(len(training), config.batch, replace=False))
        if rng.random() < 0.5:
            batch = batch.mirrored()
        loss = modified_bce_with_logits(network(batch.view), batch.truth, config.alpha)
        run.check_finite(loss, step)
        optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss)
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        schedule.step()
        done = step + 1
        run.progress(done, config.steps, first, started, {"bce": loss.item()})
        if done % config.validate_every == 0 or done == config.steps:
            run.log(done, validate(network, validation, config.validation_samples))
            network.train()
            run.checkpoint(done, network, optimizer, schedule, config)
        elif run.checkpoint_due():
            run.checkpoint(done, network, optimizer, schedule, config)


@torch.no_grad()
def validate(network: ReconstructionNetwork, views: ViewSet, count: int) -> dict[str, float]:
    """IoU on a fixed, evenly spread subset, beside what is observed alone."""
    network.eval()
    rows = np.unique(np.linspace(0, len(views) - 1, count).astype(int))
    ious, seen = [], []
    for part in np.array_split(rows, max(1, len(rows) // 16)):
        batch = views.batch(part)
        observed, free = batch.view[:, 0].numpy() > 0.5, batch.view[:, 1].numpy() > 0.5
        filled = (network(batch.view) > 0).numpy() & ~free
        truth = batch.truth.numpy() > 0.5
        ious += [iou(p, t) for p, t in zip(filled, truth, strict=True)]
        seen += [iou(o, t) for o, t in zip(observed, truth, strict=True)]
    return {"iou": float(np.mean(ious)), "observed_only": float(np.mean(seen))}
