"""Bodies that stand on a part of their width only: drawn together towards the ground."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Bool
from scipy import ndimage

from training.simulation.distance_grid import DistanceGrid
from training.simulation.families import is_balanced

SMALLEST_FOOT = 0.01
"""Least part of the body's horizontal box that is left of its foot."""


def undercut(grid: DistanceGrid, share: float, height: float) -> DistanceGrid:
    """The body narrower towards the ground, as a fruit or a bottle that stands on a part of its width only.

    Its section on the ground is drawn together towards the middle of its foot by `share`, those above by less, a
    parabola that ends at `height`. The box stays that of the whole body.

    Args:
        grid: A body that stands on z = 0.
        share: From 0 to before 1.
        height: More than 0, in the grid's unit of length.

    Raises:
        ValueError: The body does not reach the ground.
    """
    touching = np.argwhere(foot(grid))
    if not len(touching):
        raise ValueError("the body does not stand on z = 0")
    middle = (touching.min(axis=0) + touching.max(axis=0)) / 2
    values = grid.values.copy()
    for layer in range(values.shape[2]):
        z = max(grid.low[2] + grid.pitch * layer, 0.0)
        if z >= height:
            break
        narrower = 1.0 - share * (1.0 - z / height) ** 2
        values[:, :, layer] = narrower * ndimage.affine_transform(
            grid.values[:, :, layer], np.full(2, 1.0 / narrower), middle - middle / narrower, order=1, mode="nearest"
        )
    # What lies aside moves along z: divided by how much, values are no more than distances again.
    widest = max(high - low for low, high in grid.bounds[:2])
    return replace(grid, values=values / np.float32(1.0 + share * widest / height))


def foot(grid: DistanceGrid) -> Bool[np.ndarray, "x y"]:
    """Which columns of nodes are inside the body half a cell above the ground."""
    level = (0.5 * grid.pitch - grid.low[2]) / grid.pitch
    below, share = math.floor(level), level - math.floor(level)
    if not 0 <= below < grid.values.shape[2] - 1:
        return np.zeros(grid.values.shape[:2], np.bool_)
    between = (1.0 - share) * grid.values[:, :, below] + share * grid.values[:, :, below + 1]
    return np.asarray(between < 0)


def stands(cut: DistanceGrid, whole: DistanceGrid) -> bool:
    """Whether an undercut body still has a foot, its centre of mass above the box around that, and is in one piece."""
    touching, inside = foot(cut), cut.values < 0
    box = np.argwhere((whole.values < 0).any(axis=2))
    if touching.sum() < SMALLEST_FOOT * float((box.max(axis=0) - box.min(axis=0) + 1).prod()):
        return False
    _, pieces = ndimage.label(inside)
    return bool(pieces == 1 and is_balanced(inside, touching))
