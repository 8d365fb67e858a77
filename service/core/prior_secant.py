"""What the steps taken so far tell of the stiffness, on top of that of the body at rest."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from service.core.compiled import compiled
from service.core.vectors import add_share, copy, dot

MEMORY = 6
"""Steps that are remembered."""

Steps = Float32[np.ndarray, "memory 3 n"]
Scales = Float32[np.ndarray, " memory"]
Nodal = Float32[np.ndarray, "3 n"]


@compiled
def remember(move: Nodal, change: Nodal, moves: Steps, changes: Steps, scales: Scales, count: int) -> int:
    """Keep a step in the place of the oldest one, unless forces did not grow along it; how many there have been.

    Args:
        move: Of the nodes.
        change: Forces that it took.
        moves: Earlier ones.
        changes: Earlier ones.
        scales: 1/(move · change) of each.
        count: How many there have been.
    """
    product = dot(move, change)
    if not product > np.float32(0.0):
        return count
    row = count % MEMORY
    copy(move, moves[row])
    copy(change, changes[row])
    scales[row] = np.float32(1.0) / product
    return count + 1


@compiled
def take_off(moves: Steps, changes: Steps, scales: Scales, count: int, shares: Scales, forces: Nodal) -> None:
    """Take off forces what steps account for, the latest first; before the solve at rest.

    Source: the recursion of two loops, Nocedal, Math. Comp. 35 (1980); around a factor at rest, Liu, Bouaziz and Kavan,
    Quasi-Newton methods for real-time simulation of hyperelastic materials, ACM TOG 36 (2017).
    """
    for k in range(count - 1, max(count - MEMORY, 0) - 1, -1):
        row = k % MEMORY
        shares[row] = scales[row] * dot(moves[row], forces)
        add_share(-shares[row], changes[row].ravel(), forces.ravel())


@compiled
def put_on(moves: Steps, changes: Steps, scales: Scales, count: int, shares: Scales, direction: Nodal) -> None:
    """Put on a direction what steps tell of it, the oldest first; after the solve at rest."""
    for k in range(max(count - MEMORY, 0), count):
        row = k % MEMORY
        share = shares[row] - scales[row] * dot(changes[row], direction)
        add_share(share, moves[row].ravel(), direction.ravel())
