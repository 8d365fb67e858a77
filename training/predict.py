"""A network's answers as the service gives them: the same lookups, voxel for voxel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float32
from torch import Tensor

from service.core import lookup
from service.core.displacement import corrected
from training.data.batches import DeformationBatch
from training.losses import relative_displacement
from training.networks.deformation import DeformationNetwork
from training.networks.physnet import PhysNet

HALF_VOXEL = 0.5 / 64.0
"""Displacements smaller than this cannot be seen in voxels, and are not measured by their own size."""


@dataclass(frozen=True, eq=False)
class Answer:
    """Of one batch.

    Attributes:
        probability: Deformed occupancy.
        field: Backward displacement in edges of the grid; None for a network that has none.
        latent_mean: μ.
    """

    probability: Float32[np.ndarray, "b x=64 y=64 z=64"]
    field: Float32[np.ndarray, "b axis=3 x=32 y=32 z=32"] | None
    latent_mean: Float32[np.ndarray, "b latent"]


@torch.no_grad()
def predict(network: DeformationNetwork | PhysNet, batch: DeformationBatch, noise: Tensor | None = None) -> Answer:
    """The answers to a batch, for the latent's mean unless there is noise."""
    if noise is None:
        noise = torch.zeros(len(batch.condition), network.config.latent)
    if isinstance(network, PhysNet):
        logits, mean, _ = network(batch.rest, batch.condition, noise)
        return Answer(logits.sigmoid().numpy(), None, mean.numpy())
    correction, mean, _ = network(batch.rest, batch.condition, noise, batch.prior_forward)
    prior = batch.prior_backward if network.config.prior else torch.zeros_like(batch.prior_backward)
    fields = [corrected(u, d) for u, d in zip(prior.numpy(), correction.contiguous().numpy(), strict=True)]
    bodies = batch.rest_of_loads[:, 0].numpy() > 0.5
    probability = [lookup.warp(body, field) for body, field in zip(bodies, fields, strict=True)]
    return Answer(np.stack(probability), np.stack(fields), mean.numpy())


def relative_displacements(
    field: Float32[np.ndarray, "b 3 x y z"], batch: DeformationBatch
) -> Float[np.ndarray, " b"]:
    """`losses.relative_displacement` of every sample."""
    answers = torch.from_numpy(field)
    return np.array(
        [
            float(relative_displacement(answers[i : i + 1], batch.displacement[i : i + 1], batch.coverage[i : i + 1],
                                        batch.peak[i : i + 1], HALF_VOXEL))
            for i in range(len(field))
        ]
    )  # fmt: skip


def peak_ratios(field: Float32[np.ndarray, "b 3 x y z"], batch: DeformationBatch) -> Float[np.ndarray, " b"]:
    """Largest displacement in the deformed body, of what it is in truth."""
    inside = batch.coverage[:, 0].numpy() > 0
    lengths = np.where(inside, np.linalg.norm(field, axis=1), 0.0)
    return np.asarray(lengths.max(axis=(1, 2, 3)) / batch.peak.numpy())
