"""What compiled loops do with whole vectors."""

from __future__ import annotations

from functools import partial

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled

Vectors = Float32[np.ndarray, "m n"]


@partial(compiled, apart=True)
def add_share(share: np.float32, values: Float32[np.ndarray, " n"], result: Float32[np.ndarray, " more"]) -> None:
    """Add a share of values to the first of others."""
    for i in range(len(values)):
        result[i] += share * values[i]


@partial(compiled, reordered=True)
def dot(first: Vectors, second: Vectors) -> np.float32:
    """Their product."""
    a, b, total = first.ravel(), second.ravel(), np.float32(0.0)
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@compiled
def copy(values: Vectors, result: Vectors) -> None:
    """Write values over others; to assign arrays takes longer to compile."""
    for i in range(len(result)):
        for v in range(result.shape[1]):
            result[i, v] = values[i, v]
