"""Cells of a map grown and numbered by the regions that they form."""

from __future__ import annotations

import cv2
import numpy as np

from service.core.regions import grown, regions


def test_a_cell_grows_to_the_square_around_it() -> None:
    cells = np.zeros((12, 15), np.uint8)
    cells[4, 5] = cells[7, 11] = 1
    expected = np.zeros_like(cells)
    expected[1:8, 2:9] = expected[4:11, 8:15] = 1
    np.testing.assert_array_equal(grown(cells, 3), expected)


def test_cells_that_touch_by_a_corner_alone_are_two_regions() -> None:
    cells = np.array([[0, 1, 0, 1], [1, 0, 0, 1], [1, 1, 1, 1]], np.uint8)
    labels, count = regions(cells, 1)
    np.testing.assert_array_equal(labels, [[0, 1, 0, 2], [2, 0, 0, 2], [2, 2, 2, 2]])
    assert count == 2
    np.testing.assert_array_equal(regions(cells, 0)[0], [[1, 0, 2, 0], [0, 2, 2, 0], [0, 0, 0, 0]])


def test_regions_are_those_of_opencv() -> None:
    rng = np.random.default_rng(0)
    for share in (0.3, 0.5, 0.6, 0.7):
        cells = (rng.random((60, 47)) < share).astype(np.uint8)
        labels, count = regions(cells, 1)
        expected_count, expected = cv2.connectedComponents(cells, connectivity=4)
        assert 10 < count == expected_count - 1
        assert len(np.unique(np.stack([labels.ravel(), expected.ravel()]), axis=1).T) == expected_count
        first = [int(np.argmax(labels.ravel() == label)) for label in range(1, count + 1)]
        assert first == sorted(first)
