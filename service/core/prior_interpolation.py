"""Linear interpolation along one axis of an array, compiled; lattices are interpolated one axis after the other."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled

Rows = Float32[np.ndarray, "before n after"]
NewRows = Float32[np.ndarray, "before m after"]


@compiled
def interpolate(values: Rows, first: np.float32, step: np.float32, beyond: np.float32, result: NewRows) -> None:
    """Write the values at the places `first + step · i` along the middle axis.

    Args:
        values: At the places 0, 1, 2 …; two at least.
        first: Where the first place of the result is.
        step: From each to the next.
        beyond: How far the line goes on past the first and last value, after which it holds.
        result: To be written over.
    """
    last = np.float32(values.shape[1] - 1)
    below, share = np.empty(result.shape[1], np.int64), np.empty(result.shape[1], np.float32)
    for i in range(len(share)):
        place = min(max(first + np.float32(i) * step, -beyond), last + beyond)
        below[i] = min(max(int(place), 0), values.shape[1] - 2)
        share[i] = place - np.float32(below[i])
    for a in range(len(values)):
        if values.shape[2] == 1:
            line, new = values[a, :, 0], result[a, :, 0]
            for i in range(len(new)):
                new[i] = line[below[i]] + share[i] * (line[below[i] + 1] - line[below[i]])
        else:
            for i in range(len(share)):
                low, high, row = values[a, below[i]], values[a, below[i] + 1], result[a, i]
                for b in range(len(row)):
                    row[b] = low[b] + share[i] * (high[b] - low[b])
