"""Colours of displacements, the same in every viewer."""

from __future__ import annotations

import numpy as np

# Viridis at nine places, from matplotlib (van der Walt and Smith, CC0): even to the eye, also a colour-blind one.
_STOPS = np.array(
    [(68, 1, 84), (71, 44, 122), (59, 81, 139), (44, 113, 142), (33, 144, 141), (39, 173, 129), (92, 200, 99),
     (170, 220, 50), (253, 231, 37)], np.float32,
)  # fmt: skip


def colours_of(displacements_m: np.ndarray, largest_m: float) -> np.ndarray:
    """Red, green and blue (n × 3 uint8) of displacements from 0 to the largest one."""
    share = np.clip(np.nan_to_num(displacements_m) / max(largest_m, 1e-12), 0.0, 1.0) * (len(_STOPS) - 1)
    low = np.minimum(share.astype(np.int64), len(_STOPS) - 2)
    rest = (share - low)[:, None]
    return np.asarray(np.rint(_STOPS[low] * (1.0 - rest) + _STOPS[low + 1] * rest), np.uint8)
