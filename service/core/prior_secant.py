"""From corrections that each seemed right where it was made to the next place to look."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32, Float64

DEPTH = 2
"""Earlier places that a step looks back on."""

_LARGEST_SHARE = 2.0
"""Of a move between earlier places that is taken back or repeated."""

_LONGEST_STEP = 0.2
"""No correction is longer, in edges of the body grid."""

_DAMPING = 1e-4
"""Of the least squares of the step, of their mean diagonal."""

Rows = Float32[np.ndarray, "3 n loads"]


def next_place(places: Sequence[Rows], directions: Sequence[Rows]) -> Rows:
    """The next place of every load.

    The combination of corrections that is smallest, by the differences to the earlier ones, is followed for as long as
    the last correction proved right to be.

    Args:
        places: Displacements passed, the last one last.
        directions: Corrections found there.

    Source: Anderson, J. ACM 12 (1965), of depth two; the length: Barzilai and Borwein, IMA J. Numer. Anal. 8 (1988).
    """
    middle, rest = places[-1], directions[-1]
    earlier = range(len(places) - 2, max(len(places) - 2 - DEPTH, -1), -1)
    if earlier:
        moves = [places[-1] - places[k] for k in earlier]
        changes = [directions[-1] - directions[k] for k in earlier]
        products = np.stack([[_product(a, b) for b in (*changes, rest)] for a in changes])  # (depth, depth + 1, loads)
        normal = products[:, :-1].transpose(2, 0, 1).copy()
        spread = np.trace(normal, axis1=1, axis2=2) / len(moves)
        normal += (_DAMPING * spread + 1e-20)[:, None, None] * np.eye(len(moves))
        share = np.linalg.solve(normal, products[:, -1].T[:, :, None])[:, :, 0].T
        share = np.clip(share, -_LARGEST_SHARE, _LARGEST_SHARE).astype(np.float32)
        length = np.sqrt(_product(moves[0], moves[0]) / np.maximum(products[0, 0], 1e-20))
        length = np.minimum(1.0, length).astype(np.float32)
        for part, move, change in zip(share, moves, changes, strict=True):
            middle = middle - part * move
            rest = rest - part * change
        rest = length * rest
    longest = np.maximum(np.abs(rest).max(axis=(0, 1)), 1e-20)
    return np.asarray(middle + rest * np.minimum(1.0, _LONGEST_STEP / longest).astype(np.float32))


def _product(a: Rows, b: Rows) -> Float64[np.ndarray, " loads"]:
    return np.asarray((a * b).sum(axis=(0, 1)), np.float64)
