"""Displacement fields, and what they are at the voxels, in a few lines of NumPy."""

from __future__ import annotations

import numpy as np

from service.core.spread import Spread, Work


def at_voxels(field: np.ndarray, rest: np.ndarray) -> np.ndarray:
    """The field at the centres of 64³ voxels, a quarter of the way between nodes; the last value outside."""
    fine = field.astype(np.float64)
    for axis in (1, 2, 3):
        padded = np.concatenate([fine.take([0], axis), fine, fine.take([-1], axis)], axis)
        before, here, behind = (padded.take(range(start, start + 32), axis) for start in range(3))
        shape = [64 if other == axis else size for other, size in enumerate(fine.shape)]
        fine = np.stack([0.75 * here + 0.25 * before, 0.75 * here + 0.25 * behind], axis + 1).reshape(shape)
    fine[..., 0] *= ~rest[..., 0]
    return fine


def bent(seed: int, peak: float = 0.03) -> np.ndarray:
    coarse = np.random.default_rng(seed).normal(0.0, peak, (3, 4, 4, 4)).astype(np.float32)
    return np.ascontiguousarray(coarse.repeat(8, 1).repeat(8, 2).repeat(8, 3))


def parted(middle: int) -> Spread:
    """Work in two parts, the upper one first, as another thread may be sooner."""

    def spread(work: Work, end: int) -> None:
        work(middle, end)
        work(0, middle)

    return spread
