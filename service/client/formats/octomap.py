"""OctoMap's binary trees (`.bt`), which MoveIt and the navigation stacks of ROS read as obstacles. OctoMap writes them.

Of its bindings, octomap-python is a wheel of 0.4 MB for x86_64 and aarch64; pyoctomap has 8 MB and x86_64 alone.

Source: Hornung et al., OctoMap, Autonomous Robots 34 (2013) 189.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Int64

REACH = 1 << 15
"""Cells from the origin to where a tree ends."""


def encode_octomap(cells: Int64[np.ndarray, "n 3"], resolution_m: float) -> bytes:
    """A `.bt` file of occupied cells; everything else stays unknown.

    Args:
        cells: Indices of cells: cell (i, j, k) has its centre at ((i+½), (j+½), (k+½)) · resolution.
        resolution_m: Edge of a cell; the file has six digits of it.

    Raises:
        ValueError: A cell lies beyond the 2¹⁵ cells that a tree reaches in each direction.
    """
    # Imported where it is used, as the writers of the other formats are.
    import octomap

    # OctoMap leaves such cells out, and says so on stderr alone.
    if len(cells) and not -REACH <= cells.min() <= cells.max() < REACH:
        raise ValueError(f"an OctoMap of {resolution_m:g} m reaches {REACH * resolution_m:g} m from its origin")
    tree = octomap.OcTree(resolution_m)
    tree.updateNodes((cells + 0.5) * resolution_m, True, lazy_eval=True)
    tree.updateInnerOccupancy()
    return bytes(tree.writeBinary())
