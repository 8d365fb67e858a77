"""Nodal vectors in the order of the elements, and back."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float64, Int

from service.core.compiled import compiled


@compiled
def gather(
    nodal: Float64[np.ndarray, "nodes 3"], cell_nodes: Int[np.ndarray, "m 8"], element: Float64[np.ndarray, "24 m"]
) -> None:
    """Write a nodal vector to the corners of every cell, row 3·corner + axis."""
    for corner in range(8):
        for cell in range(len(cell_nodes)):
            node = cell_nodes[cell, corner]
            for axis in range(3):
                element[3 * corner + axis, cell] = nodal[node, axis]


@compiled
def scatter(
    element: Float64[np.ndarray, "24 m"], cell_nodes: Int[np.ndarray, "m 8"], nodal: Float64[np.ndarray, "nodes 3"]
) -> None:
    """Add what `gather` writes up at the nodes: its transpose."""
    for corner in range(8):
        for cell in range(len(cell_nodes)):
            node = cell_nodes[cell, corner]
            for axis in range(3):
                nodal[node, axis] += element[3 * corner + axis, cell]
