"""What a checkpoint is worth on bodies it has never seen, beside the baselines."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import torch
from jaxtyping import Bool, Float, Float32
from scipy.optimize import minimize_scalar
from torch import Tensor

from service.core.lookup import EVEN
from training.data.batches import DeformationSet, ViewSet, spread_rows
from training.metrics import (
    active_latents,
    calibration_curve,
    chamfer_distance,
    changed_voxel_iou,
    displacement_error,
    error_of_curve,
    f_score,
    iou,
    skill,
    visible_and_occluded_iou,
)
from training.networks.checkpoint import load_network
from training.networks.deformation import DeformationNetwork, shrunk
from training.networks.physnet import PhysNet
from training.networks.recgan import RecGan
from training.networks.reconstruction import ReconstructionNetwork, tempered
from training.predict import peak_ratios, predict, relative_displacements
from training.uncertainty import displacement_spread

THRESHOLDS = (0.3, 0.35, 0.4, 0.45, 0.48, 0.5, 0.55, 0.6, 0.65, 0.7, 0.8)
"""Candidates for the occupancy threshold, tuned on validation; the paper's 0.8 is among them and always printed."""

SHARES = (0.0, 0.25, 0.5, 0.75, 1.0)
"""Candidates for the share of the network's correction that is served."""

CORRECTION_SHARE = "correction_share"
"""The figure that tells which of them was tuned."""

MOVED = 0.95
"""Samples whose undeformed body overlaps the deformed one by more than this have no room for skill to show in."""

BATCH = 16

UNCERTAIN = 0.01
"""Calibration is asked of voxels whose probability lies this far from 0 and 1, or that are wrong: the empty rest of the
cube is easy and would hide them."""

Figures: TypeAlias = dict[str, int | float]
"""What was measured, by name; a figure that nothing was measured for is absent."""

Deforming: TypeAlias = DeformationNetwork | PhysNet
Reconstructing: TypeAlias = ReconstructionNetwork | RecGan


@torch.no_grad()
def evaluate_deformation(network: Deforming, samples: DeformationSet, threshold: float) -> Figures:
    """Figures over a split; those of moved samples (identity IoU below 0.95) only where there are any.

    The calibration error is told twice: of all voxels of the split together, and as the mean of each sample's own.
    """
    scores, errors, means, calibration, peaks, relative = [], [], [], [], [], []
    for rows in np.array_split(np.arange(len(samples)), max(1, len(samples) // BATCH)):
        batch = samples.batch(rows)
        answer = predict(network, batch)
        probability = answer.probability
        means.append(answer.latent_mean)
        if answer.field is not None:
            relative += list(relative_displacements(answer.field, batch))
            peaks += list(peak_ratios(answer.field, batch))
        for i in range(len(rows)):
            truth, rest = batch.deformed[i].numpy() > 0.5, batch.rest[i, 0].numpy() > 0.5
            predicted = probability[i] > threshold
            scores.append((iou(predicted, truth), iou(rest, truth), changed_voxel_iou(predicted, truth, rest),
                           iou(probability[i] > 0.8, truth)))  # fmt: skip
            calibration.append(_calibration(probability[i], truth))
            inside = batch.coverage[i, 0].numpy() > 0
            if answer.field is not None and inside.any():
                errors.append(displacement_error(answer.field[i], batch.displacement[i].numpy(), inside))
    model, identity, changed, strict = np.array(scores).T
    moved = identity < MOVED
    figures: Figures = {
        "samples": len(samples),
        "iou": float(model.mean()),
        "iou_p10": float(np.quantile(model, 0.1)),
        "iou_at_0.8": float(strict.mean()),
        "iou_identity": float(identity.mean()),
        "samples_moved": int(moved.sum()),
    }
    if moved.any():
        figures |= {
            "iou_moved": float(model[moved].mean()),
            "iou_identity_moved": float(identity[moved].mean()),
            "skill": float(skill(model[moved], identity[moved]).mean()),
            "iou_changed_voxels": float(changed[moved].mean()),
        }
    if errors:
        figures |= {
            "displacement_error": float(np.mean(relative)),
            "displacement_error_voxels": float(np.mean([e["mean_voxels"] for e in errors])),
            "displacement_error_voxels_p95": float(np.mean([e["p95_voxels"] for e in errors])),
            "displacement_error_p95": float(np.mean([e["p95_of_peak"] for e in errors])),
            "peak_ratio_median": float(np.median(peaks)),
        }
    figures["calibration_error"] = error_of_curve(np.sum(calibration, axis=0))
    figures["calibration_error_of_a_sample"] = float(np.mean([error_of_curve(curve) for curve in calibration]))
    figures["active_latents"] = active_latents(np.concatenate(means))
    return figures


def uncertain(probability: Float32[np.ndarray, "x y z"], truth: Bool[np.ndarray, "x y z"]) -> Bool[np.ndarray, "x y z"]:
    """The voxels that calibration is asked of, see `UNCERTAIN`."""
    found: Bool[np.ndarray, "x y z"] = (np.abs(probability - 0.5) < 0.5 - UNCERTAIN) | ((probability > 0.5) != truth)
    return found


def _calibration(
    probability: Float32[np.ndarray, "x y z"], truth: Bool[np.ndarray, "x y z"]
) -> Float[np.ndarray, "3 bins"]:
    counts = uncertain(probability, truth)
    return calibration_curve(probability[counts], truth[counts])


@torch.no_grad()
def evaluate_reconstruction(
    network: Reconstructing | Callable[[Tensor], Tensor], views: ViewSet, threshold: float
) -> Figures:
    """Figures over a split; free space overrules the network, as in the service.

    The calibration error is told twice: of all voxels of the split together, and as the mean of each view's own.
    """
    scores, surfaces, calibration = [], [], []
    for rows in np.array_split(np.arange(len(views)), max(1, len(views) // BATCH)):
        batch = views.batch(rows)
        probability = torch.sigmoid(network(batch.view)).numpy()
        for i in range(len(rows)):
            truth, free = batch.truth[i].numpy() > 0.5, batch.view[i, 1].numpy() > 0.5
            observed = batch.view[i, 0].numpy() > 0.5
            predicted = (probability[i] > threshold) & ~free
            scores.append((iou(predicted, truth), iou((probability[i] > 0.8) & ~free, truth), iou(observed, truth),
                           *visible_and_occluded_iou(predicted, truth, observed)))  # fmt: skip
            calibration.append(_calibration(np.where(free, 0.0, probability[i]).astype(np.float32), truth))
            if predicted.any() and truth.any():
                surfaces.append((chamfer_distance(predicted, truth), f_score(predicted, truth)))
    model, strict, seen, visible, occluded = np.array(scores).T
    figures: Figures = {
        "samples": len(views),
        "iou": float(model.mean()),
        "iou_p10": float(np.quantile(model, 0.1)),
        "iou_at_0.8": float(strict.mean()),
        "iou_observed_only": float(seen.mean()),
        "iou_visible": float(visible.mean()),
        "iou_occluded": float(occluded.mean()),
        "calibration_error": error_of_curve(np.sum(calibration, axis=0)),
        "calibration_error_of_a_view": float(np.mean([error_of_curve(curve) for curve in calibration])),
        "samples_empty": len(scores) - len(surfaces),
    }
    if surfaces:
        chamfer, score = np.array(surfaces).T
        figures |= {"chamfer_voxels": float(chamfer.mean()), "f_score_1_voxel": float(score.mean())}
    return figures


@torch.no_grad()
def tune_threshold(network: Deforming | Reconstructing, samples: DeformationSet | ViewSet, count: int = 160) -> float:
    """The candidate threshold of the highest mean IoU on an evenly spread part of the validation split."""
    rows = spread_rows(len(samples), count)
    totals = np.zeros(len(THRESHOLDS))
    for part in np.array_split(rows, max(1, len(rows) // BATCH)):
        probability, truth = _answer(network, samples, part)
        totals += [sum(iou(p > cut, t) for p, t in zip(probability, truth, strict=True)) for cut in THRESHOLDS]
    return THRESHOLDS[int(totals.argmax())]


@torch.no_grad()
def tune_temperature(network: ReconstructionNetwork, views: ViewSet, count: int = 320) -> float:
    """The temperature of the greatest likelihood on an evenly spread part of the validation split.

    Every eighth voxel that is not free; the overlap in the loss makes a network surer than it ought to be.
    """
    rows = spread_rows(len(views), count)
    logits, truths = [], []
    for part in np.array_split(rows, max(1, len(rows) // BATCH)):
        batch = views.batch(part)
        asked = (batch.view[:, 1] < 0.5).flatten().nonzero().flatten()[::8]
        logits.append(network(batch.view).flatten()[asked])
        truths.append(batch.truth.flatten()[asked])
    logit, truth = torch.cat(logits), torch.cat(truths)

    def surprise(log_temperature: float) -> float:
        scaled = logit / float(np.exp(log_temperature))
        return float(torch.nn.functional.binary_cross_entropy_with_logits(scaled, truth))

    found = minimize_scalar(surprise, bounds=(-1.0, 1.0), method="bounded", options={"xatol": 1e-3})
    return round(float(np.exp(found.x)), 3)


@torch.no_grad()
def tune_share(network: DeformationNetwork, samples: DeformationSet, count: int = 160) -> float:
    """The share of the correction with the least relative displacement error on an evenly spread part of a split.

    A network that guesses how far the coarse solve is off, and is often wrong, gains by saying less than it thinks.
    """
    rows = spread_rows(len(samples), count)
    candidates = [shrunk(network, share) for share in SHARES]
    totals = np.zeros(len(SHARES))
    for part in np.array_split(rows, max(1, len(rows) // BATCH)):
        batch = samples.batch(part)
        for i, candidate in enumerate(candidates):
            field = predict(candidate, batch).field
            assert field is not None, "a deformation network has a field"
            totals[i] += relative_displacements(field, batch).sum()
    return SHARES[int(totals.argmin())]


def _answer(
    network: Deforming | Reconstructing, samples: DeformationSet | ViewSet, rows: np.ndarray
) -> tuple[Float32[np.ndarray, "b x y z"], Bool[np.ndarray, "b x y z"]]:
    """Served probability and truth of a few samples."""
    if isinstance(network, Deforming) and isinstance(samples, DeformationSet):
        load = samples.batch(rows)
        return predict(network, load).probability, load.deformed.numpy() > 0.5
    if isinstance(network, Reconstructing) and isinstance(samples, ViewSet):
        view = samples.batch(rows)
        probability = torch.sigmoid(network(view.view)) * (view.view[:, 1] < 0.5)
        return probability.numpy(), view.truth.numpy() > 0.5
    raise TypeError(f"{type(network).__name__} cannot be judged on a {type(samples).__name__}")


def as_served(
    network: Deforming, validation: DeformationSet, threshold: float | None = None
) -> tuple[Deforming, float, Figures]:
    """The network with the share of its correction that is served, its threshold, and what was tuned of the share.

    Where a coarse solve is corrected, the threshold is `EVEN`, not tuned: a body looked up must come back as it is
    where nothing moves, and one that was reconstructed is told from what is around it by little more than that.
    """
    tuned: Figures = {}
    if isinstance(network, DeformationNetwork) and network.config.prior:
        tuned[CORRECTION_SHARE] = tune_share(network, validation)
        network = as_tuned(network, tuned)
        threshold = threshold or EVEN
    return network, threshold or tune_threshold(network, validation), tuned


def as_tuned(network: Deforming, figures: Mapping[str, Any]) -> Deforming:
    """The network with the share of its correction that these figures of it tell; itself where they tell of none."""
    if not isinstance(network, DeformationNetwork) or CORRECTION_SHARE not in figures:
        return network
    return shrunk(network, figures[CORRECTION_SHARE])


def evaluate(checkpoint: Path, data: Path, split: str, threshold: float | None = None) -> tuple[float, dict[str, Any]]:
    """Tune the share of the correction and, unless it is given, the threshold (see `as_served`), then score a split.

    Returns:
        The threshold, and the figures.
    """
    network, _ = load_network(checkpoint)
    figures: Figures
    if isinstance(network, Deforming):
        network, threshold, tuned = as_served(network, DeformationSet.load(data, "validation"), threshold)
        judged = DeformationSet.load(data, split)
        figures = evaluate_deformation(network, judged, threshold) | tuned
        if isinstance(network, DeformationNetwork):
            figures |= displacement_spread(network, judged)
    elif isinstance(network, Reconstructing):
        validation, tuned = ViewSet.load(data, "validation"), {}
        if isinstance(network, ReconstructionNetwork):
            tuned["temperature"] = tune_temperature(network, validation)
            network = tempered(network, tuned["temperature"])
        threshold = threshold or tune_threshold(network, validation)
        figures = evaluate_reconstruction(network, ViewSet.load(data, split), threshold) | tuned
    else:
        raise TypeError(f"a {type(network).__name__} is no network that could be judged")
    return threshold, {"split": split, **figures}
