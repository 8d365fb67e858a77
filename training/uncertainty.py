"""How far a network's answers part when its latent is drawn, and whether that tells how far off they are."""

from __future__ import annotations

import numpy as np
import torch
from jaxtyping import Float
from scipy.stats import spearmanr

from training.data.batches import DeformationBatch, DeformationSet, spread_rows
from training.networks.deformation import DeformationNetwork
from training.predict import predict

DRAWS = 8
BATCH = 16


@torch.no_grad()
def displacement_spread(
    network: DeformationNetwork, samples: DeformationSet, draws: int = DRAWS, count: int = 160
) -> dict[str, float]:
    """The spread of the displacement over draws of the latent, beside its error, on an evenly spread part of a split.

    Returns:
        `displacement_spread`: the mean spread as a share of the peak that is answered; `spread_correlation`: Spearman's
        between spread and error of the samples, both in edges of the grid; `spread_correlation_of_peak`: the same of
        both as shares of the answered peak, where it is of no help that what moves far is off by more.
    """
    rows = spread_rows(len(samples), count)
    rng = np.random.default_rng(0)
    found = []
    for part in np.array_split(rows, max(1, len(rows) // BATCH)):
        batch = samples.batch(part)
        noise = rng.standard_normal((draws, 1, network.config.latent)).astype(np.float32)
        answers = [predict(network, batch, torch.from_numpy(draw).expand(len(part), -1)).field for draw in noise]
        found.append(_spread_error_peak(np.stack([field for field in answers if field is not None]), batch))
    spread, error, peak = np.concatenate(found, axis=1)
    return {
        "displacement_spread": float((spread / peak).mean()),
        "spread_correlation": rank_correlation(spread, error),
        "spread_correlation_of_peak": rank_correlation(spread / peak, error / peak),
    }


def _spread_error_peak(
    fields: Float[np.ndarray, "draws b 3 x y z"], batch: DeformationBatch
) -> Float[np.ndarray, "of=3 b"]:
    """Of each sample over its deformed body: distance of the draws from their mean, error of the mean, its peak."""
    mean = fields.mean(axis=0)
    inside = batch.coverage[:, 0].numpy() > 0
    lengths = (
        np.sqrt(np.square(fields - mean).sum(axis=2).mean(axis=0)),
        np.linalg.norm(mean - batch.displacement.numpy(), axis=1),
        np.linalg.norm(mean, axis=1),
    )
    spread, error, moved = (np.where(inside, length, 0.0) for length in lengths)
    voxels = inside.sum(axis=(1, 2, 3))
    return np.stack([
        spread.sum(axis=(1, 2, 3)) / voxels, error.sum(axis=(1, 2, 3)) / voxels,
        np.maximum(moved.max(axis=(1, 2, 3)), np.finfo(np.float32).tiny),
    ])  # fmt: skip


def rank_correlation(a: Float[np.ndarray, " n"], b: Float[np.ndarray, " n"]) -> float:
    """Spearman's; 0 where one of them never changes and so tells nothing."""
    if np.ptp(a) == 0 or np.ptp(b) == 0:
        return 0.0
    return float(spearmanr(a, b).statistic)
