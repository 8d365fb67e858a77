"""Cholesky's method for a symmetric band matrix, compiled: eight rows at a time, so that the loops are long and busy.

Rows are kept in panels of eight, only from the diagonal to the band's end. The factor is kept twice, by rows and by
columns, so that both substitutions run along memory.
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float32, Int

from service.core.compiled import compiled

PANEL = 8
"""Rows of a panel."""

_LEAST_PIVOT = np.float32(1e-6)
"""Of what stood on the diagonal: a smaller pivot is rounding."""

Panels = Float32[np.ndarray, "panels 8 width"]
Ends = Int[np.ndarray, " panels"]
Eight: TypeAlias = tuple[float, float, float, float, float, float, float, float]


class BandFactor(NamedTuple):
    """The factor UᵀU of a symmetric positive definite band matrix.

    Attributes:
        upper: Row p of panel k is row 8k + p of U, from column 8k on.
        lower: Row p of panel k is column 8k + p of U, up to row 8k − 1, which stands at the right.
        begins: First row of U that reaches each panel.
        ends: One past the last column of each panel.
    """

    upper: Panels
    lower: Panels
    begins: Ends
    ends: Ends


def factorised(upper: Panels, ends: Ends) -> BandFactor:
    """The factor, written over the matrix.

    Args:
        upper: The matrix, laid out as `BandFactor.upper`; left of the diagonal nothing is read.
        ends: One past the last column of each panel, multiples of 8 that never decrease.

    Raises:
        np.linalg.LinAlgError: A pivot is not positive, or not in single precision.

    Source: Golub and Van Loan, Matrix Computations (2013), section 4.3.5.
    """
    begins = PANEL * np.searchsorted(ends, PANEL * np.arange(len(ends)), side="right")
    lower = np.zeros_like(upper)
    if not _factorise(upper, lower, ends):
        raise np.linalg.LinAlgError("the matrix is not positive definite in single precision")
    return BandFactor(upper, lower, begins, ends)


@compiled
def substitute(factor: BandFactor, values: Float32[np.ndarray, "loads dof"]) -> None:
    """Replace right-hand sides, 8 values a panel, by their solutions; a panel serves all loads while it is at hand."""
    upper, width = factor.upper, factor.upper.shape[2]
    for k in range(len(upper)):
        rows, first = upper[k], PANEL * k
        for load in range(len(values)):
            own = values[load, first : first + PANEL]
            for p in range(len(own)):
                own[p] /= rows[p, p]
                for q in range(p + 1, len(own)):
                    own[q] -= rows[p, q] * own[p]
            _subtract(values[load, first + PANEL : factor.ends[k]], _eight(own), rows, PANEL)
    for k in range(len(upper) - 1, -1, -1):
        rows, first, begin = upper[k], PANEL * k, factor.begins[k]
        for load in range(len(values)):
            own = values[load, first : first + PANEL]
            for p in range(len(own) - 1, -1, -1):
                own[p] /= rows[p, p]
                for q in range(p):
                    own[q] -= rows[q, p] * own[p]
            _subtract(values[load, begin:first], _eight(own), factor.lower[k], width - (first - begin))


@compiled
def _factorise(upper: Panels, lower: Panels, ends: Ends) -> bool:
    """Write the factor; False where a pivot is not positive. See `BandFactor`."""
    width = upper.shape[2]
    least = np.empty((len(upper), PANEL), np.float32)
    for k in range(len(upper)):
        for p in range(PANEL):
            least[k, p] = _LEAST_PIVOT * upper[k, p, p]
    for k in range(len(upper)):
        rows, count = upper[k], ends[k] - PANEL * k
        if not _factorise_panel(rows, least[k], count):
            return False
        for i in range(PANEL, count, 2):
            block, inner = i // PANEL, i % PANEL
            own, next_own, end = _column(rows, i), _column(rows, i + 1), count - PANEL * block
            targets = upper[k + block, inner, inner:end], upper[k + block, inner + 1, inner:end]
            _subtract_two(targets[0], targets[1], own, next_own, rows, i)
            _set_eight(lower[k + block, inner, width - PANEL * block :], own)
            _set_eight(lower[k + block, inner + 1, width - PANEL * block :], next_own)
    return True


@compiled
def _factorise_panel(rows: Float32[np.ndarray, "8 width"], least: Float32[np.ndarray, "8"], count: int) -> bool:
    for p in range(len(rows)):
        pivot, row = rows[p, p], rows[p, p:count]
        if not pivot > least[p]:
            return False
        scale = np.float32(1.0) / np.sqrt(pivot)
        for j in range(len(row)):
            row[j] *= scale
        for q in range(p + 1, len(rows)):
            factor, row, target = rows[p, q], rows[p, q:count], rows[q, q:count]
            for j in range(len(row)):
                target[j] -= factor * row[j]
    return True


@compiled
def _subtract(
    target: Float32[np.ndarray, " count"], share: Eight, rows: Float32[np.ndarray, "8 width"], first: int
) -> None:
    """Take shares of eight rows, from their place `first` on, off the target."""
    a, b, c, d, e, f, g, h = share
    last = first + len(target)
    row_a, row_b, row_c, row_d = rows[0, first:last], rows[1, first:last], rows[2, first:last], rows[3, first:last]
    row_e, row_f, row_g, row_h = rows[4, first:last], rows[5, first:last], rows[6, first:last], rows[7, first:last]
    for j in range(len(target)):
        target[j] -= (
            a * row_a[j] + b * row_b[j] + c * row_c[j] + d * row_d[j]
            + e * row_e[j] + f * row_f[j] + g * row_g[j] + h * row_h[j]
        )  # fmt: skip


@compiled
def _subtract_two(
    target: Float32[np.ndarray, " count"], other: Float32[np.ndarray, " count"], share: Eight, other_share: Eight,
    rows: Float32[np.ndarray, "8 width"], first: int,
) -> None:  # fmt: skip
    """`_subtract` for two targets, for which the rows are read once."""
    a, b, c, d, e, f, g, h = share
    i, j, k, m, n, o, p, q = other_share
    last = first + len(target)
    row_a, row_b, row_c, row_d = rows[0, first:last], rows[1, first:last], rows[2, first:last], rows[3, first:last]
    row_e, row_f, row_g, row_h = rows[4, first:last], rows[5, first:last], rows[6, first:last], rows[7, first:last]
    for x in range(len(target)):
        target[x] -= (
            a * row_a[x] + b * row_b[x] + c * row_c[x] + d * row_d[x]
            + e * row_e[x] + f * row_f[x] + g * row_g[x] + h * row_h[x]
        )  # fmt: skip
        other[x] -= (
            i * row_a[x] + j * row_b[x] + k * row_c[x] + m * row_d[x]
            + n * row_e[x] + o * row_f[x] + p * row_g[x] + q * row_h[x]
        )  # fmt: skip


@compiled
def _column(rows: Float32[np.ndarray, "8 width"], j: int) -> Eight:
    return rows[0, j], rows[1, j], rows[2, j], rows[3, j], rows[4, j], rows[5, j], rows[6, j], rows[7, j]


@compiled
def _eight(values: Float32[np.ndarray, "8"]) -> Eight:
    return values[0], values[1], values[2], values[3], values[4], values[5], values[6], values[7]


@compiled
def _set_eight(values: Float32[np.ndarray, " more"], eight: Eight) -> None:
    values[0], values[1], values[2], values[3], values[4], values[5], values[6], values[7] = eight
