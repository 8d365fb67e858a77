import numpy as np
import pytest

from service.core.prior_factor import PANEL
from service.core.prior_twisted import TwistedFactor, add, factorised, solve


def ends_of(matrix: np.ndarray) -> np.ndarray:
    """One past the last column of each panel, never fewer than of the panel before."""
    last = [
        PANEL * (np.flatnonzero(rows.any(axis=0)).max() // PANEL + 1) for rows in np.split(matrix, len(matrix) // 8)
    ]
    return np.maximum.accumulate(np.array(last, np.int64))


def factor_of(matrix: np.ndarray) -> TwistedFactor:
    def assemble(upper: np.ndarray, end: int, backward: bool) -> None:
        last = len(matrix) - 1
        for row, column in zip(*np.nonzero(np.triu(matrix)), strict=True):
            if (column >= end) == backward:
                place = (last - column, last - row) if backward else (row, column)
                add(upper, *place, np.float32(matrix[row, column]))

    return factorised(ends_of(matrix), ends_of(matrix[::-1, ::-1]), assemble)


def banded(rows: int, reach: int) -> np.ndarray:
    """Positive definite; some rows couple less far than others."""
    rng = np.random.default_rng(rows + reach)
    matrix = 4.0 * reach * np.eye(rows)
    for row in range(rows):
        for column in range(row + 1, min(rows, row + 1 + (reach if row % 24 < 16 else reach // 2))):
            matrix[row, column] = matrix[column, row] = rng.normal()
    return matrix


@pytest.mark.parametrize(
    ("rows", "reach"), [(8, 4), (16, 15), (96, 10), (96, 30), (96, 60), (96, 95), (200, 24), (240, 1)]
)
def test_solutions_are_those_of_the_dense_matrix(rows: int, reach: int) -> None:
    matrix = banded(rows, reach)
    right = np.random.default_rng(1).normal(size=(3, rows)).astype(np.float32)
    solution, factor = right.copy(), factor_of(matrix)
    solve(factor, solution)
    expected = np.linalg.solve(matrix, right.T).T
    np.testing.assert_allclose(solution, expected, atol=1e-5 * np.abs(expected).max())


def test_a_long_band_is_cut_in_the_middle_and_a_full_matrix_is_not() -> None:
    long, full = factor_of(banded(400, 16)), factor_of(banded(96, 95))
    assert abs(long.before - long.after) <= 2
    assert long.before + long.after >= 46  # of 50 panels
    assert full.after == 0


def test_parts_that_do_not_couple_have_no_middle() -> None:
    matrix = np.zeros((48, 48))
    matrix[:24, :24], matrix[24:, 24:] = banded(24, 20), banded(24, 20)
    factor = factor_of(matrix)
    assert (factor.before, factor.after) == (3, 3)
    right = np.ones((1, 48), np.float32)
    solve(factor, right)
    np.testing.assert_allclose(right[0], np.linalg.solve(matrix, np.ones(48)), atol=1e-6)


@pytest.mark.parametrize("row", [3, 48, 90])  # in the first part, the middle, the second part
def test_a_matrix_that_is_not_positive_definite_is_refused(row: int) -> None:
    matrix = banded(96, 12)
    matrix[row, row] = -1.0
    with pytest.raises(np.linalg.LinAlgError):
        factor_of(matrix)
