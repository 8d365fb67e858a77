"""Cholesky's method for a symmetric band matrix, compiled: eight rows at a time, so that the loops are long and busy.

Rows are kept in panels of eight, only from the diagonal to the band's end. Indices without a sign are not looked at for
counting from the end.
"""

from __future__ import annotations

from functools import partial
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float32, Int

from service.core.compiled import compiled

PANEL = 8
"""Rows of a panel."""

_LEAST_PIVOT = np.float32(1e-6)
"""Of what stood on the diagonal: a smaller pivot is rounding."""

Panels = Float32[np.ndarray, "panels 8 width"]
Panel = Float32[np.ndarray, "8 width"]
Values = Float32[np.ndarray, " n"]
Ends = Int[np.ndarray, " panels"]
Pivots = Float32[np.ndarray, "panels 8"]
RightSides = Float32[np.ndarray, "loads dof"]
Eight: TypeAlias = tuple[float, float, float, float, float, float, float, float]

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)
_NEXT, _TWO, _EIGHT = np.uintp(1), np.uintp(2), np.uintp(PANEL)


class Band(NamedTuple):
    """A symmetric band matrix or, where its panels are eliminated, its factor UᵀU.

    Attributes:
        upper: Row p of panel k is row 8k + p, from column 8k on; left of the diagonal nothing is read. On the diagonal
            of a factor stand the inverses.
        ends: One past the last column of each panel, multiples of 8 that never decrease.
    """

    upper: Panels
    ends: Ends


@compiled
def add(upper: Panels, row: int, column: int, value: np.float32) -> None:
    """Add to an entry on the diagonal or right of it."""
    panel = row // PANEL
    upper[panel, row - PANEL * panel, column - PANEL * panel] += value


@compiled
def least_pivots(band: Band) -> Pivots:
    """Of a matrix of which nothing is eliminated: a smaller pivot is rounding."""
    least = np.empty((len(band.upper), PANEL), np.float32)
    for k in range(len(least)):
        for p in range(PANEL):
            least[k, p] = _LEAST_PIVOT * band.upper[k, p, p]
    return least


@compiled
def eliminate(band: Band, least: Pivots, first: int, end: int) -> bool:
    """Write the factor over panels from the first to before the end, and take off later ones what they stand for.

    Args:
        band: Panels before the first are eliminated.
        least: See `least_pivots`.
        first: Panel.
        end: Panel.

    Returns:
        False where the matrix is not positive definite, or not in single precision.

    Source: Golub and Van Loan, Matrix Computations (2013), section 4.3.5.
    """
    upper = band.upper
    rows = np.empty((PANEL, upper.shape[2]), np.float32)
    for k in range(first, end):
        own, count = upper[k], band.ends[k] - PANEL * k
        if not _factorise_diagonal(own, least[k]):
            return False
        _solve_rows(own, rows, np.uintp(count))
        for column in range(PANEL, count, PANEL):
            _subtract(upper[k + column // PANEL], rows, np.uintp(column), np.uintp(count - column))
        for p in range(PANEL):
            for j in range(PANEL, count):
                own[p, j] = rows[p, j]
    return True


@compiled
def substitute(factor: Band, values: RightSides, first: int, end: int) -> None:
    """Solve with the lower factor's panels from the first to before the end: Uᵀy = b, in the place of b.

    A panel serves all loads while it is at hand; 8 values belong to each.
    """
    for k in range(first, end):
        start, stop = PANEL * k, factor.ends[k]
        for load in range(len(values)):
            row = values[load]
            _eliminate(row[start : start + PANEL], factor.upper[k], row[start + PANEL : stop])


@compiled
def substitute_back(factor: Band, values: RightSides, first: int, end: int) -> None:
    """Solve with the upper factor's panels, the last before the end first: Ux = y, in the place of y."""
    for k in range(end - 1, first - 1, -1):
        start, stop = PANEL * k, factor.ends[k]
        for load in range(len(values)):
            row = values[load]
            _substitute_back(row[start : start + PANEL], factor.upper[k], row[start + PANEL : stop])


@compiled
def _factorise_diagonal(own: Panel, least: Float32[np.ndarray, "8"]) -> bool:
    """The 8×8 block on the diagonal, with inverses on the diagonal itself."""
    for p in range(PANEL):
        if not own[p, p] > least[p]:
            return False
        scale = _ONE / np.sqrt(own[p, p])
        own[p, p] = scale
        for j in range(p + 1, PANEL):
            own[p, j] *= scale
        for q in range(p + 1, PANEL):
            for j in range(q, PANEL):
                own[q, j] -= own[p, q] * own[p, j]
    return True


@partial(compiled, apart=True)
def _solve_rows(own: Panel, rows: Panel, count: np.uintp) -> None:
    """What of the factor is right of the block on the diagonal."""
    d0, d1, d2, d3, d4, d5, d6, d7 = (
        own[0, 0], own[1, 1], own[2, 2], own[3, 3], own[4, 4], own[5, 5], own[6, 6], own[7, 7]
    )  # fmt: skip
    u01, u02, u03, u04, u05, u06, u07 = own[0, 1], own[0, 2], own[0, 3], own[0, 4], own[0, 5], own[0, 6], own[0, 7]
    u12, u13, u14, u15, u16, u17 = own[1, 2], own[1, 3], own[1, 4], own[1, 5], own[1, 6], own[1, 7]
    u23, u24, u25, u26, u27 = own[2, 3], own[2, 4], own[2, 5], own[2, 6], own[2, 7]
    u34, u35, u36, u37 = own[3, 4], own[3, 5], own[3, 6], own[3, 7]
    u45, u46, u47, u56, u57, u67 = own[4, 5], own[4, 6], own[4, 7], own[5, 6], own[5, 7], own[6, 7]
    for j in range(_EIGHT, count):
        a = d0 * own[0, j]
        b = d1 * (own[1, j] - u01 * a)
        c = d2 * (own[2, j] - u02 * a - u12 * b)
        d = d3 * (own[3, j] - u03 * a - u13 * b - u23 * c)
        e = d4 * (own[4, j] - u04 * a - u14 * b - u24 * c - u34 * d)
        f = d5 * (own[5, j] - u05 * a - u15 * b - u25 * c - u35 * d - u45 * e)
        g = d6 * (own[6, j] - u06 * a - u16 * b - u26 * c - u36 * d - u46 * e - u56 * f)
        h = d7 * (own[7, j] - u07 * a - u17 * b - u27 * c - u37 * d - u47 * e - u57 * f - u67 * g)
        rows[0, j], rows[1, j], rows[2, j], rows[3, j] = a, b, c, d
        rows[4, j], rows[5, j], rows[6, j], rows[7, j] = e, f, g, h


@partial(compiled, apart=True)
def _subtract(target: Panel, rows: Panel, first: np.uintp, count: np.uintp) -> None:
    """Take off a later panel what eight rows of the factor, from column `first` on, stand for; two rows at a time."""
    for i in range(np.uintp(0), _EIGHT, _TWO):
        a, b, c, d, e, f, g, h = _column(rows, first + i)
        k, m, n, o, p, q, r, s = _column(rows, first + i + _NEXT)
        for x in range(count):
            ra, rb, rc, rd, re, rf, rg, rh = _column(rows, first + x)
            target[i, x] -= a * ra + b * rb + c * rc + d * rd + e * re + f * rf + g * rg + h * rh
            target[i + _NEXT, x] -= k * ra + m * rb + n * rc + o * rd + p * re + q * rf + r * rg + s * rh


@partial(compiled, apart=True)
def _eliminate(own: Values, rows: Panel, right: Values) -> None:
    """Solve for eight values, and take what they stand for off those to the right of them."""
    for p in range(PANEL):
        own[p] *= rows[p, p]
        for q in range(p + 1, PANEL):
            own[q] -= rows[p, q] * own[p]
    a, b, c, d, e, f, g, h = own[0], own[1], own[2], own[3], own[4], own[5], own[6], own[7]
    for x in range(np.uintp(len(right))):
        ra, rb, rc, rd, re, rf, rg, rh = _column(rows, x + _EIGHT)
        right[x] -= a * ra + b * rb + c * rc + d * rd + e * re + f * rf + g * rg + h * rh


@partial(compiled, apart=True, reordered=True)
def _substitute_back(own: Values, rows: Panel, right: Values) -> None:
    """Solve for eight values, those to the right of them known."""
    a, b, c, d, e, f, g, h = _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO, _ZERO
    for x in range(np.uintp(len(right))):
        ra, rb, rc, rd, re, rf, rg, rh = _column(rows, x + _EIGHT)
        a, b, c, d = a + ra * right[x], b + rb * right[x], c + rc * right[x], d + rd * right[x]
        e, f, g, h = e + re * right[x], f + rf * right[x], g + rg * right[x], h + rh * right[x]
    own[0], own[1], own[2], own[3] = own[0] - a, own[1] - b, own[2] - c, own[3] - d
    own[4], own[5], own[6], own[7] = own[4] - e, own[5] - f, own[6] - g, own[7] - h
    for p in range(PANEL - 1, -1, -1):
        own[p] *= rows[p, p]
        for q in range(p):
            own[q] -= rows[q, p] * own[p]


@compiled
def _column(rows: Panel, j: np.uintp) -> Eight:
    return rows[0, j], rows[1, j], rows[2, j], rows[3, j], rows[4, j], rows[5, j], rows[6, j], rows[7, j]
