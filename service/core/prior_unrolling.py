"""From the linear solution, which swells what it turns, to a start that does not."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled
from service.core.prior_cells import Cells, Corners, at_corners, at_nodes, cell_forces, gradients
from service.core.prior_rotation import exponentials, spin_axes, turn

_LARGEST_ROTATION = np.float32(1.3)
"""Radians. A cantilever under a dead load turns towards the load, by π/2 at the very most."""

Loads = Float32[np.ndarray, "loads 3 n"]


@compiled
def unroll(cells: Cells, displacement: Loads, result: Loads) -> None:
    """The forces that belong to linear solutions with the rotations of their cells made finite.

    A cell's displacement without its mean and its infinitesimal rotation ω is turned by exp(ω); under these forces the
    elastic energy of what the cells then miss is least. A load that would turn a cell farther than dead loads do is
    taken at a share: linear elasticity winds a body up without end.

    Source: Huang et al., Interactive shape interpolation through rotation-strain coordinates, TVCG 17 (2011).
    """
    k = cells.nodes.shape[1]
    corners, turned = np.empty((8, 3, k), np.float32), np.empty((8, 3, k), np.float32)
    rotation, axis, mean = np.empty((3, 3, k), np.float32), np.empty((3, k), np.float32), np.empty(k, np.float32)
    for load in range(len(displacement)):
        at_corners(cells, displacement[load], corners)
        gradients(cells, corners, rotation)
        spin_axes(rotation, axis)
        largest = np.float32(1e-20)
        for c in range(k):
            largest = max(largest, axis[0, c] * axis[0, c] + axis[1, c] * axis[1, c] + axis[2, c] * axis[2, c])
        share = min(np.float32(1.0), _LARGEST_ROTATION / np.sqrt(largest))
        exponentials(axis, share, rotation)
        for i in range(len(axis)):
            spin_j, spin_k = axis[(i + 1) % 3], axis[(i + 2) % 3]
            mean[:] = 0.0
            for a in range(len(corners)):
                row = corners[a, i]
                for c in range(k):
                    mean[c] += np.float32(0.125) * row[c]
            for a in range(len(corners)):
                row, rest_j, rest_k = corners[a, i], cells.rest[a, (i + 1) % 3], cells.rest[a, (i + 2) % 3]
                for c in range(k):
                    row[c] = share * (row[c] - mean[c] - (spin_j[c] * rest_k - spin_k[c] * rest_j))
        _add_rest(cells, np.float32(1.0), corners)
        for a in range(len(corners)):
            turn(rotation, corners[a], turned[a])
        _add_rest(cells, np.float32(-1.0), turned)
        cell_forces(cells, turned, corners)
        at_nodes(cells, corners, result[load])


@compiled
def _add_rest(cells: Cells, times: np.float32, corners: Corners) -> None:
    """From displacements of the corners to their places, or back."""
    for a in range(len(corners)):
        for i in range(corners.shape[1]):
            row, rest = corners[a, i], times * cells.rest[a, i]
            for c in range(len(row)):
                row[c] += rest
