"""From corrections that each seemed right where it was made to the next place to look."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled

_LARGEST_SHARE = 2.0
"""Of a move between earlier places that is taken back or repeated."""

_LONGEST_STEP = np.float32(0.2)
"""No correction is longer, in edges of the body grid."""

_DAMPING = 1e-4
"""Of the least squares of the step, of their mean diagonal."""

_TINY = 1e-20


@compiled
def next_places(
    places: Float32[np.ndarray, "steps loads 3 n"], directions: Float32[np.ndarray, "steps loads 3 n"], step: int
) -> None:
    """Write the next place of every load after those of this step.

    The combination of corrections that is smallest, by the differences to the two earlier ones, is followed for as long
    as the last correction proved right to be.

    Args:
        places: Displacements passed; those after this step are not read.
        directions: Corrections found there.
        step: From 0.

    Source: Anderson, J. ACM 12 (1965), of depth two; the length: Barzilai and Borwein, IMA J. Numer. Anal. 8 (1988).
    """
    for load in range(places.shape[1]):
        now, rest = places[step, load].ravel(), directions[step, load].ravel()
        # without an earlier place the last one stands for it: no move, no change
        place_1, rest_1 = places[max(step - 1, 0), load].ravel(), directions[max(step - 1, 0), load].ravel()
        place_2, rest_2 = places[max(step - 2, 0), load].ravel(), directions[max(step - 2, 0), load].ravel()
        if step < 2:
            place_2, rest_2 = now, rest
        move, one, other, both, left_1, left_2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for i in range(len(now)):
            change_1, change_2 = rest[i] - rest_1[i], rest[i] - rest_2[i]
            move += (now[i] - place_1[i]) ** 2
            one += change_1 * change_1
            other += change_2 * change_2
            both += change_1 * change_2
            left_1 += change_1 * rest[i]
            left_2 += change_2 * rest[i]
        share_1, share_2 = _least_squares(one, other, both, left_1, left_2)
        length = np.float32(min(1.0, np.sqrt(move / max(one, _TINY)))) if step else np.float32(1.0)
        result, longest = places[step + 1, load].ravel(), np.float32(_TINY)
        for i in range(len(now)):
            correction = length * (rest[i] - share_1 * (rest[i] - rest_1[i]) - share_2 * (rest[i] - rest_2[i]))
            result[i] = correction
            longest = max(longest, abs(correction))
        scale = min(np.float32(1.0), _LONGEST_STEP / longest)
        for i in range(len(now)):
            middle = now[i] - share_1 * (now[i] - place_1[i]) - share_2 * (now[i] - place_2[i])
            result[i] = middle + scale * result[i]


@compiled
def _least_squares(
    one: float, other: float, both: float, left_1: float, left_2: float
) -> tuple[np.float32, np.float32]:
    """Shares of the two changes that leave least of the last correction."""
    damping = _TINY + _DAMPING * (one + other) / (2.0 if other > 0.0 else 1.0)
    one, other = one + damping, other + damping
    determinant = one * other - both * both
    share_1, share_2 = (left_1 * other - left_2 * both) / determinant, (left_2 * one - left_1 * both) / determinant
    return (
        np.float32(min(max(share_1, -_LARGEST_SHARE), _LARGEST_SHARE)),
        np.float32(min(max(share_2, -_LARGEST_SHARE), _LARGEST_SHARE)),
    )
