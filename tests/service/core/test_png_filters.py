"""Rows of a PNG, filtered here by the specification's formulas and undone by the kernel."""

from __future__ import annotations

import numpy as np
import pytest

from service.core.png_filters import unfilter, unfilter_bytes


def predictor(kind: int, left: int, up: int, corner: int) -> int:
    """PNG specification, 9.2 and 9.4."""
    if kind == 4:
        guess = left + up - corner
        return min((left, up, corner), key=lambda neighbour: abs(guess - neighbour))
    return (0, left, up, (left + up) // 2)[kind]


def filtered(pixels: np.ndarray, kinds: list[int]) -> np.ndarray:
    """The bytes of each row behind its filter, of each pixel the high one first."""
    size = pixels.itemsize
    plain = np.pad(pixels.astype(pixels.dtype.newbyteorder(">")).view(np.uint8).astype(int), ((1, 0), (size, 0)))
    rows = np.empty((len(pixels), 1 + size * pixels.shape[1]), np.uint8)
    for row, kind in enumerate(kinds):
        rows[row, 0] = kind
        for place in range(size, plain.shape[1]):
            left, up, corner = plain[row + 1, place - size], plain[row, place], plain[row, place - size]
            rows[row, place - size + 1] = (plain[row + 1, place] - predictor(kind, left, up, corner)) % 256
    return rows


@pytest.mark.parametrize("first", range(5))
def test_every_filter_is_undone_whatever_comes_above_it(first: int) -> None:
    rng = np.random.default_rng(first)
    counts = rng.integers(0, 2**16, (10, 23), np.uint16)
    counts[4:] = 700 + rng.integers(0, 40, (6, 23))  # neighbours near to each other, as in a depth image
    kinds = [(first + row * (1 + row // 5)) % 5 for row in range(10)]
    found = np.empty_like(counts)
    assert unfilter(filtered(counts, kinds), found)
    np.testing.assert_array_equal(found, counts)
    grey = (counts % 251).astype(np.uint8)
    found = np.empty_like(grey)
    assert unfilter_bytes(filtered(grey, kinds), found)
    np.testing.assert_array_equal(found, grey)


@pytest.mark.parametrize("width", [1, 2, 17])
@pytest.mark.parametrize("rows", [2, 3, 4])
def test_paeths_filter_is_undone_in_rows_below_each_other(rows: int, width: int) -> None:
    rng = np.random.default_rng(rows)
    counts = rng.integers(0, 2**16, (rows + 2, width), np.uint16)
    counts[:, ::3] = 700 + rng.integers(0, 40, counts[:, ::3].shape)
    for kinds in ([4] * (rows + 2), [2, *[4] * rows, 1]):
        found = np.empty_like(counts)
        assert unfilter(filtered(counts, kinds), found)
        np.testing.assert_array_equal(found, counts)


def test_a_filter_that_is_none_is_told() -> None:
    rows = np.zeros((2, 7), np.uint8)
    rows[1, 0] = 5
    assert not unfilter(rows, np.empty((2, 3), np.uint16))
    assert not unfilter_bytes(rows, np.empty((2, 6), np.uint8))
