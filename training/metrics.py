"""How good an answer is: the same figures wherever a model is judged."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Float64
from scipy import ndimage

ACTIVE_VARIANCE = 0.01
"""A latent dimension is active where the posterior mean varies more than this over the data."""


def iou(a: Bool[np.ndarray, "*shape"], b: Bool[np.ndarray, "*shape"]) -> float:
    """Intersection over union; 1 for two empty grids."""
    union = int((a | b).sum())
    return int((a & b).sum()) / union if union else 1.0


def skill(iou_model: Float[np.ndarray, " n"], iou_identity: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """(IoU - IoU_identity) / (1 - IoU_identity): 0 for a model that moves nothing, 1 for a perfect one.

    Samples whose identity is perfect have nothing to gain and count as 0 or, if the model spoils them, as -1.
    """
    room = 1.0 - iou_identity
    with np.errstate(divide="ignore", invalid="ignore"):
        value = (iou_model - iou_identity) / room
    return np.where(room > 1e-6, value, np.where(iou_model < 1.0, -1.0, 0.0))


def changed_voxel_iou(
    predicted: Bool[np.ndarray, "x y z"], truth: Bool[np.ndarray, "x y z"], rest: Bool[np.ndarray, "x y z"]
) -> float:
    """IoU of the sets of voxels that changed against the undeformed body."""
    return iou(predicted ^ rest, truth ^ rest)


def active_latents(mean: Float[np.ndarray, "n latent"]) -> int:
    """How many latent dimensions carry anything: those whose posterior mean has a variance above 0.01 over the data.

    Source: Burda, Grosse, Salakhutdinov, "Importance Weighted Autoencoders", ICLR 2016, section 5.2.
    """
    return int((mean.var(axis=0) > ACTIVE_VARIANCE).sum())


def displacement_error(
    predicted: Float[np.ndarray, "axis=3 x y z"],
    truth: Float[np.ndarray, "axis=3 x y z"],
    inside: Bool[np.ndarray, "x y z"],
    voxels: int = 64,
) -> dict[str, float]:
    """Mean and 95th percentile of |u - û| over the body, in voxels and as a share of the largest |u| there.

    Args:
        predicted: û in edges of the grid.
        truth: u likewise.
        inside: Where the body is; outside of it nothing is compared.
        voxels: Voxels along an edge of the output grid.

    Raises:
        ValueError: The body is empty.
    """
    if not inside.any():
        raise ValueError("there is no displacement error of an empty body")
    error = np.linalg.norm((predicted - truth)[:, inside].astype(np.float64), axis=0)
    peak = float(np.linalg.norm(truth[:, inside].astype(np.float64), axis=0).max())
    mean, p95 = float(error.mean()), float(np.quantile(error, 0.95))
    # A body that does not move has no peak to measure by; a perfect answer to it is still perfect.
    return {
        "mean_voxels": mean * voxels,
        "p95_voxels": p95 * voxels,
        "mean_of_peak": mean / peak if peak > 0 else float(mean > 0),
        "p95_of_peak": p95 / peak if peak > 0 else float(p95 > 0),
    }


def surface(occupancy: Bool[np.ndarray, "x y z"]) -> Bool[np.ndarray, "x y z"]:
    """Voxels of a body with a face to the outside; what lies beyond the grid is outside."""
    padded = np.pad(occupancy, 1)
    return occupancy & ~ndimage.binary_erosion(padded)[1:-1, 1:-1, 1:-1]


def surface_distances(
    predicted: Bool[np.ndarray, "x y z"], truth: Bool[np.ndarray, "x y z"]
) -> tuple[Float[np.ndarray, " p"], Float[np.ndarray, " t"]]:
    """From every surface voxel of one body to the nearest of the other, in voxels, both ways.

    Raises:
        ValueError: One of them is empty: there is no nearest voxel of nothing.
    """
    if not predicted.any() or not truth.any():
        raise ValueError("an empty body has no surface to measure a distance to")
    predicted, truth = _around(predicted, truth)
    of_predicted, of_truth = surface(predicted), surface(truth)
    to_truth = ndimage.distance_transform_edt(~of_truth)[of_predicted]
    to_predicted = ndimage.distance_transform_edt(~of_predicted)[of_truth]
    return np.asarray(to_truth), np.asarray(to_predicted)


def _around(*grids: Bool[np.ndarray, "x y z"]) -> tuple[Bool[np.ndarray, "width depth height"], ...]:
    """What of the grids lies in the box around all of their bodies: distances between them are the same there."""
    either = np.logical_or.reduce(grids)
    place = []
    for axis in range(3):
        filled = np.flatnonzero(either.any(axis=tuple(other for other in range(3) if other != axis)))
        place.append(slice(filled[0], filled[-1] + 1))
    return tuple(grid[tuple(place)] for grid in grids)


def chamfer_distance(predicted: Bool[np.ndarray, "x y z"], truth: Bool[np.ndarray, "x y z"]) -> float:
    """Mean distance from each surface to the other, averaged over the two ways, in voxels."""
    to_truth, to_predicted = surface_distances(predicted, truth)
    return float((to_truth.mean() + to_predicted.mean()) / 2)


def f_score(
    predicted: Bool[np.ndarray, "x y z"], truth: Bool[np.ndarray, "x y z"], within_voxels: float = 1.0
) -> float:
    """Harmonic mean of precision and recall of the surface, each within a distance of one voxel.

    Source: Tatarchenko et al., "What Do Single-view 3D Reconstruction Networks Learn?", CVPR 2019, section 5.
    """
    to_truth, to_predicted = surface_distances(predicted, truth)
    precision, recall = float((to_truth <= within_voxels).mean()), float((to_predicted <= within_voxels).mean())
    return 2 * precision * recall / (precision + recall) if precision + recall > 0 else 0.0


def visible_and_occluded_iou(
    predicted: Bool[np.ndarray, "x y z"],
    truth: Bool[np.ndarray, "x y z"],
    observed: Bool[np.ndarray, "x y z"],
    within_voxels: float = 1.5,
) -> tuple[float, float]:
    """IoU where the camera saw the surface, and where it did not.

    Args:
        predicted: The reconstruction.
        truth: The body.
        observed: Voxels that the camera saw occupied.
        within_voxels: A voxel this near to an observed one counts as visible; 1.5 takes in all but the corners of the
            27 around it, as far as a noisy depth may be off.
    """
    if not observed.any():
        return 1.0, iou(predicted, truth)
    predicted, truth, observed = _around(predicted, truth, observed)
    visible = ndimage.distance_transform_edt(~observed) <= within_voxels
    return iou(predicted & visible, truth & visible), iou(predicted & ~visible, truth & ~visible)


def calibration_curve(
    probability: Float[np.ndarray, "*shape"], truth: Bool[np.ndarray, "*shape"], bins: int = 15
) -> Float64[np.ndarray, "3 bins"]:
    """Voxels, the sum of their probabilities and the true ones among them, in equal bins of the probability."""
    place = np.minimum((probability.ravel() * bins).astype(int), bins - 1)
    of_voxels = (None, probability.ravel().astype(np.float64), truth.ravel().astype(np.float64))
    return np.stack([np.bincount(place, weights, minlength=bins).astype(np.float64) for weights in of_voxels])


def calibration_error(
    probability: Float[np.ndarray, "*shape"], truth: Bool[np.ndarray, "*shape"], bins: int = 15
) -> float:
    """Expected calibration error: how far the share of true voxels is from the probability, over equal bins of it.

    Voxels in the outermost bins count too; leave out what is certainly empty before, or it hides the rest.

    Source: Guo et al., "On Calibration of Modern Neural Networks", ICML 2017, eq. 3.
    """
    return error_of_curve(calibration_curve(probability, truth, bins))


def error_of_curve(curve: Float[np.ndarray, "3 bins"]) -> float:
    """The same of a `calibration_curve`, or of the sum of several grids' curves; 0 of no voxels."""
    voxels, said, found = curve
    return float(np.abs(said - found).sum() / max(voxels.sum(), 1.0))
