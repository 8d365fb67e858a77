"""Colours of displacements, the same in every viewer."""

from __future__ import annotations

import numpy as np

# Viridis at 17 places, from matplotlib (van der Walt and Smith, CC0): even to the eye, also a colour-blind one.
_STOPS = np.array(
    [(68, 1, 84), (72, 24, 106), (71, 45, 123), (66, 64, 134), (59, 82, 139), (51, 99, 141), (44, 114, 142),
     (38, 130, 142), (33, 144, 140), (31, 159, 136), (39, 173, 129), (62, 188, 116), (92, 200, 99), (130, 211, 77),
     (170, 220, 50), (213, 226, 26), (253, 231, 37)], np.float32,
)  # fmt: skip


def colours_of(displacements_m: np.ndarray, largest_m: float) -> np.ndarray:
    """Red, green and blue (n × 3 uint8) of displacements from 0 to the largest one."""
    share = np.clip(np.nan_to_num(displacements_m) / max(largest_m, 1e-12), 0.0, 1.0) * (len(_STOPS) - 1)
    low = np.minimum(share.astype(np.int64), len(_STOPS) - 2)
    rest = (share - low)[:, None]
    return np.asarray(np.rint(_STOPS[low] * (1.0 - rest) + _STOPS[low + 1] * rest), np.uint8)
