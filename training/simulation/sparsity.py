"""Where the matrices of the cells go in the global one."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from jaxtyping import Bool, Float64, Int

from training.simulation.elements import PAIRS_24


@dataclass(frozen=True, eq=False)
class SparsityPattern:
    """Upper triangle of the global matrix over the free degrees of freedom, in CSR form.

    Attributes:
        indptr: Row starts.
        indices: Column of every stored entry, ascending in a row.
        position: Entry of each of the 300 × m element entries; `len(indices)` for those of clamped nodes.
    """

    indptr: Int[np.ndarray, " rows"]
    indices: Int[np.ndarray, " nonzeros"]
    position: Int[np.ndarray, " entries"]

    @classmethod
    def of(cls, cell_nodes: Int[np.ndarray, "m 8"], clamped: Bool[np.ndarray, " nodes"]) -> SparsityPattern:
        """Count the entries of a stiffness; the corners of every cell must be in ascending order of their numbers."""
        # counted on blocks of 3×3 between nodes, a ninth of the entries; node and dof order agree
        free_nodes = ~clamped
        count = int(free_nodes.sum())
        number = np.full(len(clamped), -1)
        number[free_nodes] = np.arange(count)
        node = number[cell_nodes.T]
        a, b = np.triu_indices(8)
        # nodes are numbered in the order of the grid, and so are the corners of a cell: a never exceeds b
        low, high = node[a], node[b]
        held = (low < 0) | (high < 0)
        blocks, block_of = np.unique((low * count + high)[~held], return_inverse=True)
        block_row, block_column = blocks // count, blocks % count
        # in block row r the diagonal block comes first and has 3, 2, 1 entries, every other block 3 in each row
        blocks_in_row = np.bincount(block_row, minlength=count)
        first_block = np.cumsum(blocks_in_row) - blocks_in_row
        lengths = 3 * blocks_in_row[:, None] - np.arange(3)
        indptr = np.concatenate([[0], np.cumsum(lengths.ravel())])
        rank = np.arange(len(blocks)) - first_block[block_row]
        entry = np.empty((len(blocks), 3, 3), np.int64)
        for i in range(3):
            entry[:, i] = indptr[3 * block_row + i, None] + 3 * rank[:, None] + np.arange(3) - i
        indices = np.empty(indptr[-1], np.int32)
        upper = np.ones((len(blocks), 3, 3), bool)
        upper[rank == 0] = np.triu(np.ones((3, 3), bool))
        indices[entry[upper]] = np.broadcast_to(3 * block_column[:, None, None] + np.arange(3), upper.shape)[upper]
        block = np.full(node[a].shape, -1)
        block[~held] = block_of
        block_number = np.full((8, 8), -1)
        block_number[a, b] = np.arange(len(a))
        position = np.empty((len(PAIRS_24[0]), node.shape[1]), np.int64)
        for index, (row, column) in enumerate(np.stack(PAIRS_24, axis=1).tolist()):
            pair = block_number[row // 3, column // 3]
            i, j = row % 3, column % 3
            position[index] = entry[block[pair], i, j]
            position[index][held[pair]] = len(indices)
        return cls(indptr.astype(np.int32), indices, position.ravel())

    def assemble(self, element: Float64[np.ndarray, "300 m"]) -> Float64[np.ndarray, " nonzeros"]:
        """Values of the global matrix from the element matrices."""
        count = len(self.indices)
        return np.bincount(self.position, weights=element.ravel(), minlength=count + 1)[:count]

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
