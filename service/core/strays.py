"""Readings of a mask that are not of its object: what is seen beside it and behind it."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

from service.core.arrays import Points, Vector3
from service.core.footprints import find_footprints

STRAY_SHARE = 0.01
"""A part of a mask beside its largest one with less than this share of that one's points is stray: readings at the
object's edge that lie between it and what is behind it."""


def without_background(points: Points, up: Vector3) -> Bool[np.ndarray, " n"]:
    """Which points of a mask are not far from its largest part, as background beyond the object's edge is."""
    footprints = find_footprints(points, up, points[len(points) // 2].astype(np.float64))
    labels = np.ones(len(points), np.int32) if footprints is None else footprints.label_of(points)
    counts = np.bincount(labels)
    if np.count_nonzero(counts) == 1:
        return np.ones(len(points), np.bool_)
    main = labels == np.argmax(counts)
    low, high = points[main].min(axis=0), points[main].max(axis=0)
    # The far side of a deep cup is seen apart from its near side, at most one diameter behind it.
    reach_m = np.linalg.norm(high - low)
    gap_m = np.linalg.norm(np.maximum(np.maximum(low - points, points - high), 0.0), axis=1)
    large = counts >= STRAY_SHARE * counts.max()
    return np.asarray((gap_m == 0.0) | (large[labels] & (gap_m < reach_m)), np.bool_)
