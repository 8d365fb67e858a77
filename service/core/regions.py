"""Regions of a map: cells grown to their neighbours, and those that touch numbered as one."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int32, UInt8

from service.core.compiled import compiled


@compiled
def grown(cells: UInt8[np.ndarray, "rows columns"], reach: int) -> UInt8[np.ndarray, "rows columns"]:
    """1 for cells at most `reach` rows and columns from one that is set to 1; none may be set that near to the border.

    So all are shifted at once, rows laid end to end.
    """
    after = cells.ravel()
    for step in (1, cells.shape[1]):
        before, after = after, after.copy()
        for far in range(step, (reach + 1) * step, step):
            for cell in range(len(after) - far):
                after[cell] |= before[np.uintp(cell + far)]
            for cell in range(len(after) - far):
                after[np.uintp(cell + far)] |= before[cell]
    return after.reshape(cells.shape)


@compiled
def regions(cells: UInt8[np.ndarray, "rows columns"], value: int) -> tuple[Int32[np.ndarray, "rows columns"], int]:
    """Number the regions of cells of one value that touch side by side, from 1 on in the order of their first cells.

    Returns:
        The number of each cell's region, 0 for cells of another value; and how many regions there are.
    """
    rows, columns = cells.shape
    labels = np.zeros((rows, columns), np.int32)
    # A label's own, or a lower one that turned out to be of the same region.
    same = np.zeros(rows * columns // 2 + 2, np.int32)
    given = 0
    for row in range(rows):
        left = 0
        for column in range(columns):
            if cells[row, column] != value:
                left = 0
                continue
            above = labels[row - 1, column] if row > 0 else 0
            if above == 0 and left == 0:
                given += 1
                same[given] = left = given
            elif above == 0 or left == 0 or above == left:
                left = max(above, left)
            else:
                while same[above] < above:
                    above = same[above]
                while same[left] < left:
                    left = same[left]
                same[max(above, left)] = left = min(above, left)
            labels[row, column] = left
    count = 0
    for label in range(1, given + 1):
        if same[label] == label:
            count += 1
            same[label] = count
        else:
            same[label] = same[same[label]]
    for row in range(rows):
        for column in range(columns):
            labels[row, column] = same[labels[row, column]]
    return labels, count
