"""Where the matrices of the cells go in the global one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float64, Int

from service.core.compiled import compiled
from training.simulation.elements import CORNERS, PAIRS_24

_WAYS = 14
"""Ways from a node to itself and to those of its 26 neighbours that come after it, in the order of the grid."""


@dataclass(frozen=True, eq=False)
class SparsityPattern:
    """Upper triangle of the global matrix over the free degrees of freedom, in CSR form.

    Attributes:
        indptr: Row starts.
        indices: Column of every stored entry, ascending in a row.
        block: Number of the 3×3 block of each of the 36 pairs of corners of each cell; −1 where one is clamped.
        start: Entry of column 0 in each row of each block, or where it would be in those on the diagonal.
    """

    indptr: Int[np.ndarray, " rows"]
    indices: Int[np.ndarray, " nonzeros"]
    block: Int[np.ndarray, "36 m"]
    start: Int[np.ndarray, "3 blocks"]

    @classmethod
    def of(cls, cell_nodes: Int[np.ndarray, "m 8"], clamped: Bool[np.ndarray, " nodes"]) -> SparsityPattern:
        """Count the entries of a stiffness; nodes must be numbered in the order of the grid."""
        # counted on blocks of 3×3 between nodes, a ninth of the entries; node and dof order agree
        free_nodes = ~clamped
        count = int(free_nodes.sum())
        number = np.full(len(clamped), count)  # clamped nodes go into a row too many
        number[free_nodes] = np.arange(count)
        node = number[cell_nodes.T]
        a, b = np.triu_indices(8)
        low, high = node[a], node[b]
        held = (low == count) | (high == count)
        low = np.where(held, count, low)
        # a block by its first node and the way from there to the second: columns ascend with its place in the grid
        way = ((CORNERS[b] - CORNERS[a]) @ [9, 3, 1])[:, None]
        second = np.full((count + 1, _WAYS), -1)
        second[low, way] = high
        present = second[:count] >= 0
        block_row, block_way = np.nonzero(present)
        block_column = second[block_row, block_way]
        number_of_block = np.full(second.shape, -1)
        number_of_block[block_row, block_way] = np.arange(len(block_row))
        # in block row r the diagonal block comes first and has 3, 2, 1 entries, every other block 3 in each row
        blocks_in_row = present.sum(axis=1)
        first_block = np.cumsum(blocks_in_row) - blocks_in_row
        indptr = np.concatenate([[0], np.cumsum((3 * blocks_in_row[:, None] - np.arange(3)).ravel())])
        rank = np.arange(len(block_row)) - first_block[block_row]
        start = indptr[3 * block_row + np.arange(3)[:, None]] + 3 * rank - np.arange(3)[:, None]
        indices = np.empty(indptr[-1], np.int32)
        for i in range(3):
            for j in range(3):
                kept = (rank > 0) | (j >= i)
                indices[start[i, kept] + j] = 3 * block_column[kept] + j
        block = np.where(held, -1, number_of_block[low, way])
        return cls(indptr.astype(np.int32), indices, block, start)

    def assemble(self, element: Float64[np.ndarray, "300 m"]) -> Float64[np.ndarray, " nonzeros"]:
        """Values of the global matrix from the element matrices."""
        values = np.zeros(len(self.indices))
        _add_elements(element, self.block, self.start, _ROWS, _COLUMNS, _PAIRS, values)
        return values

    def spread(self, scalar: sp.csr_array, clamped: Bool[np.ndarray, " nodes"]) -> Float64[np.ndarray, " nonzeros"]:
        """Values of a matrix that couples nodes of one cell, each axis to itself by the same number.

        Args:
            scalar: Symmetric, over all nodes.
            clamped: As given to `of`.
        """
        free = np.flatnonzero(~clamped)
        upper = sp.triu(scalar[free][:, free], format="coo")
        size = len(self.indptr) - 1
        keys = np.repeat(np.arange(size), np.diff(self.indptr)) * size + self.indices
        values = np.zeros(len(self.indices))
        for axis in range(3):
            wanted = (3 * upper.row.astype(np.int64) + axis) * size + 3 * upper.col + axis
            values[np.searchsorted(keys, wanted)] += upper.data
        return values


_ROWS, _COLUMNS = (index % 3 for index in PAIRS_24)
"""Row and column of each of the 300 entries of an element matrix within the block of its corners."""
_PAIRS = np.array([8 * a - a * (a + 1) // 2 + b for a, b in zip(*(index // 3 for index in PAIRS_24), strict=True)])
"""And the number of that pair of corners."""


@compiled
def _add_elements(
    element: Float64[np.ndarray, "300 m"],
    block: Int[np.ndarray, "36 m"],
    start: Int[np.ndarray, "3 blocks"],
    rows: Int[np.ndarray, " 300"],
    columns: Int[np.ndarray, " 300"],
    pairs: Int[np.ndarray, " 300"],
    values: Float64[np.ndarray, " nonzeros"],
) -> None:
    """Add every entry of the element matrices to its place."""
    for entry in range(len(rows)):
        row, column, pair = rows[entry], columns[entry], pairs[entry]
        for cell in range(element.shape[1]):
            if block[pair, cell] >= 0:
                values[start[row, block[pair, cell]] + column] += element[entry, cell]
