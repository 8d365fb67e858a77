"""How good an answer is: the same figures wherever a model is judged."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float


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
