"""A band matrix factorised from both of its ends at once, each in a thread of its own, to where they meet.

Rows of the first part couple to none of the second, only to those in the middle. Backwards, row r of n is n − 1 − r.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np

from service.core.compiled import compiled
from service.core.prior_factor import (
    PANEL,
    Band,
    Ends,
    Panels,
    Pivots,
    RightSides,
    add,
    eliminate,
    least_pivots,
    substitute,
    substitute_back,
)
from service.core.spread import Spread, in_turn

Assemble: TypeAlias = Callable[[Panels, int, bool], None]
"""Adds to panels that are 0: the entries whose columns are before the one given, or backwards the others."""


class TwistedFactor(NamedTuple):
    """The factor of a symmetric positive definite band matrix.

    Attributes:
        forward: Of its rows from the first on, those of the middle last.
        backward: Of its rows from the last on, backwards; then what they took off the middle.
        before: Panels of the first part.
        after: Panels of the second.

    Source: van der Vorst, Large tridiagonal and block tridiagonal linear systems on vector and parallel computers,
    Parallel Computing 5 (1987).
    """

    forward: Band
    backward: Band
    before: int
    after: int


def factorised(ends: Ends, backward_ends: Ends, assemble: Assemble, spread: Spread = in_turn) -> TwistedFactor:
    """Assemble a matrix and factorise it.

    Args:
        ends: One past the last column of each panel, multiples of 8 that never decrease.
        backward_ends: The same of the matrix backwards.
        assemble: Says what the matrix is.
        spread: Cores for its two parts.

    Raises:
        np.linalg.LinAlgError: A pivot is not positive, or not in single precision.
    """
    before, after = _cut(ends, backward_ends)
    end = len(ends) - after
    parts = ((ends[:end], before), (backward_ends[: len(ends) - before], after))
    done: dict[int, tuple[Band, Pivots, bool]] = {}

    def work(first: int, last: int) -> None:
        for part in range(first, last):
            own_ends, own = parts[part]
            band = _zeros(own_ends)
            assemble(band.upper, PANEL * end, part == 1)
            least = least_pivots(band)
            done[part] = band, least, eliminate(band, least, 0, own)

    spread(work, 2)
    (forward, least, one), (backward, _, other) = done[0], done[1]
    factor = TwistedFactor(forward, backward, before, after)
    if not (one and other and _meet(factor, least)):
        raise np.linalg.LinAlgError("the matrix is not positive definite in single precision")
    return factor


@compiled
def row_count(factor: TwistedFactor) -> int:
    """Rows of the whole matrix."""
    return PANEL * (len(factor.forward.ends) + factor.after)


@compiled
def solve(factor: TwistedFactor, values: RightSides) -> None:
    """Replace right-hand sides, 8 values a panel, by their solutions."""
    forward, backward, before, after = factor
    end, own = len(forward.ends), PANEL * after
    one, other = values[:, : PANEL * end].copy(), np.zeros((len(values), PANEL * len(backward.ends)), np.float32)
    last, middle = values.shape[1] - 1, other.shape[1]
    for load in range(len(values)):
        for row in range(own):
            other[load, row] = values[load, last - row]
    substitute(forward, one, 0, before)
    substitute(backward, other, 0, after)
    for load in range(len(values)):
        for row in range(own, middle):
            one[load, last - row] += other[load, row]
    substitute(forward, one, before, end)
    substitute_back(forward, one, 0, end)
    for load in range(len(values)):
        for row in range(own, middle):
            other[load, row] = one[load, last - row]
    substitute_back(backward, other, 0, after)
    for load in range(len(values)):
        for row in range(one.shape[1]):
            values[load, row] = one[load, row]
        for row in range(own):
            values[load, last - row] = other[load, row]


def _zeros(ends: Ends) -> Band:
    """With as many columns as there are rows: what couples beyond lies in the other band."""
    panels = len(ends)
    ends = np.minimum(ends, PANEL * panels)
    width = int((ends - PANEL * np.arange(panels)).max(initial=PANEL))
    return Band(np.zeros((panels, PANEL, width), np.float32), ends)


@compiled
def _cut(ends: Ends, backward_ends: Ends) -> tuple[int, int]:
    """Panels from the first on and from the last on of which the longer takes the least."""
    panels = len(ends)
    cost = np.zeros(panels + 1, np.int64)  # of as many panels from the last on
    for k in range(panels):
        cost[k + 1] = cost[k] + (backward_ends[k] - PANEL * k) ** 2
    best, before, own = cost[panels], 0, 0
    for k in range(panels):
        own += (ends[k] - PANEL * k) ** 2
        longer = max(own, cost[panels - ends[k] // PANEL])
        if longer <= best:
            best, before = longer, k + 1
    return before, panels - ends[before - 1] // PANEL


@compiled
def _meet(factor: TwistedFactor, least: Pivots) -> bool:
    """Take off the middle what the second part stands for, and eliminate it; False as by `eliminate`."""
    forward, backward, before, after = factor
    end = 0 if after == 0 else backward.ends[after - 1]
    last = row_count(factor) - 1
    for row in range(PANEL * after, end):
        panel = row // PANEL
        for column in range(row, end):
            taken_off = backward.upper[panel, row - PANEL * panel, column - PANEL * panel]
            add(forward.upper, last - column, last - row, taken_off)
    return eliminate(forward, least, before, len(forward.ends))
