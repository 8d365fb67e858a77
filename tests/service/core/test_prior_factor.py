import numpy as np

from service.core.prior_factor import PANEL, Band, eliminate, least_pivots, substitute, substitute_back


def band(matrix: np.ndarray, ends: np.ndarray) -> Band:
    upper = np.zeros((len(ends), PANEL, int((ends - PANEL * np.arange(len(ends))).max())), np.float32)
    for k, end in enumerate(ends):
        upper[k, :, : end - PANEL * k] = matrix[PANEL * k : PANEL * (k + 1), PANEL * k : end]
    return Band(upper, ends)


def banded() -> tuple[np.ndarray, np.ndarray]:
    """A matrix whose band widens and narrows, and its ends."""
    ends = np.array([16, 40, 40, 48, 48, 48])
    rng = np.random.default_rng(0)
    matrix = 20.0 * np.eye(48)
    for row in range(48):
        for column in range(row + 1, ends[row // PANEL]):
            matrix[row, column] = matrix[column, row] = rng.normal()
    return matrix, ends


def factor_of(matrix: np.ndarray, ends: np.ndarray) -> Band:
    factor = band(matrix, ends)
    assert eliminate(factor, least_pivots(factor), 0, len(ends))
    return factor


def test_solutions_with_the_factor_are_those_of_the_dense_matrix() -> None:
    matrix, ends = banded()
    right = np.random.default_rng(1).normal(size=(3, 48)).astype(np.float32)
    solution, factor = right.copy(), factor_of(matrix, ends)
    substitute(factor, solution, 0, len(ends))
    substitute_back(factor, solution, 0, len(ends))
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right.T).T, atol=1e-6)


def test_the_factor_is_choleskys_with_inverses_on_the_diagonal() -> None:
    matrix, ends = banded()
    factor = factor_of(matrix, ends)
    expected = np.linalg.cholesky(matrix).T
    np.fill_diagonal(expected, 1.0 / np.diag(expected))
    for k, end in enumerate(ends):
        first = PANEL * k
        rows = np.triu(factor.upper[k][:, : end - first])
        np.testing.assert_allclose(rows, expected[first : first + PANEL, first:end], atol=1e-6)


def test_panels_that_are_not_eliminated_hold_schurs_complement() -> None:
    matrix, ends = banded()
    part = band(matrix, ends)
    assert eliminate(part, least_pivots(part), 0, 2)
    left = matrix[16:, 16:] - matrix[16:, :16] @ np.linalg.solve(matrix[:16, :16], matrix[:16, 16:])
    for k, end in enumerate(ends[2:]):
        first = PANEL * k
        rows = np.triu(part.upper[k + 2][:, : end - 16 - first])
        np.testing.assert_allclose(rows, np.triu(left[first : first + PANEL, first : end - 16]), atol=1e-5)


def test_a_matrix_that_is_not_positive_definite_is_refused() -> None:
    matrix, ends = banded()
    matrix[30, 30] = -1.0
    factor = band(matrix, ends)
    assert not eliminate(factor, least_pivots(factor), 0, len(ends))
