"""Rigid transforms for tests."""

from __future__ import annotations

import numpy as np


def pose(
    rotation: tuple[float, float, float] = (0.0, 0.0, 0.0), translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> np.ndarray:
    """Rotations about x, then y, then z in radians, then a translation."""
    result = np.eye(4)
    for axis, angle in enumerate(rotation):
        turn = np.eye(3)
        i, j = [a for a in range(3) if a != axis]
        sign = -1.0 if axis == 1 else 1.0
        turn[i, i] = turn[j, j] = np.cos(angle)
        turn[i, j], turn[j, i] = -sign * np.sin(angle), sign * np.sin(angle)
        result[:3, :3] = turn @ result[:3, :3]
    result[:3, 3] = translation
    return result
