"""Plane frames of slender beams that turn by any angle: the large deflections of a bridge, followed load by load."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float64, Int

TOLERANCE = 1e-6
"""Unbalanced forces, as a share of the load, at which a state counts as one of equilibrium."""
MAX_ITERATIONS = 25
_LONGEST_STEP = 3.0
"""No Newton step moves a node farther than this, in the unit of the nodes, or turns it by more, in radians."""

Motion = Float64[np.ndarray, "nodes 3"]
"""Displacement along x and z and counterclockwise rotation of every node."""


class PlaneFrame:
    """Elastic beams between nodes of a plane: small strains, rotations of up to π.

    Args:
        nodes: Places at rest, x and z.
        first: Node at which each beam begins.
        last: Node at which it ends.
        bending: Bending stiffness E I of each beam.
        axial: Its axial stiffness E A.
        clamped: Nodes that neither move nor turn.

    Source: corotational beams: Crisfield, Non-linear Finite Element Analysis of Solids and Structures 1 (1991), 7.3.
    """

    def __init__(
        self,
        nodes: Float64[np.ndarray, "nodes 2"],
        first: Int[np.ndarray, " beams"],
        last: Int[np.ndarray, " beams"],
        bending: Float64[np.ndarray, " beams"],
        axial: Float64[np.ndarray, " beams"],
        clamped: Sequence[int],
    ) -> None:
        self.nodes, self.first, self.last = nodes, first, last
        span = nodes[last] - nodes[first]
        self.length = np.hypot(*span.T)
        self.direction = span / self.length[:, None]
        self.bending, self.axial = bending / self.length, axial / self.length
        held = np.zeros((len(nodes), 3), bool)
        held[list(clamped)] = True
        self.free = np.flatnonzero(~held.ravel())
        self.dof = np.concatenate([3 * end[:, None] + np.arange(3) for end in (first, last)], axis=1)
        self._entry = (3 * len(nodes) * self.dof[:, :, None] + self.dof[:, None, :]).ravel()

    def chords(
        self, motion: Float64[np.ndarray, "*states nodes 3"]
    ) -> tuple[Float64[np.ndarray, "*states beams 2"], Float64[np.ndarray, "*states beams 2"]]:
        """Vector from end to end of every beam, and how far its two ends are turned from it."""
        first, last = motion[..., self.first, :], motion[..., self.last, :]
        chord = self.nodes[self.last] - self.nodes[self.first] + last[..., :2] - first[..., :2]
        along = (chord * self.direction).sum(axis=-1)
        across = self.direction[:, 0] * chord[..., 1] - self.direction[:, 1] * chord[..., 0]
        turned = np.arctan2(across, along)
        return chord, np.stack([first[..., 2] - turned, last[..., 2] - turned], axis=-1)

    def balance(self, motion: Motion) -> tuple[Float64[np.ndarray, " dof"], Float64[np.ndarray, "dof dof"]]:
        """Nodal forces that hold a state, and their derivative."""
        chord, ends = self.chords(motion)
        length = np.hypot(*chord.T)
        (c, s), zero = chord.T / length, np.zeros(len(chord))
        strained = np.stack([-c, -s, zero, c, s, zero], axis=1)
        turned = np.stack([s, -c, zero, -s, c, zero], axis=1) / length[:, None]
        unit = np.eye(6)
        modes = np.stack([strained, unit[2] - turned, unit[5] - turned], axis=1)
        law = np.zeros((len(chord), 3, 3))
        law[:, 0, 0] = self.axial
        law[:, 1:, 1:] = self.bending[:, None, None] * np.array([[4.0, 2.0], [2.0, 4.0]])
        within = np.einsum("bij,bj->bi", law, np.concatenate([(length - self.length)[:, None], ends], axis=1))
        forces = np.einsum("bi,bid->bd", within, modes)
        tangent = np.einsum("bid,bij,bje->bde", modes, law, modes, optimize=True)
        tangent += (within[:, 0] * length)[:, None, None] * turned[:, :, None] * turned[:, None, :]
        mixed = strained[:, :, None] * turned[:, None, :]
        tangent += ((within[:, 1] + within[:, 2]) / length)[:, None, None] * (mixed + mixed.transpose(0, 2, 1))
        size = motion.size
        return (
            np.bincount(self.dof.ravel(), forces.ravel(), size),
            np.bincount(self._entry, tangent.ravel(), size * size).reshape(size, size),
        )

    def follow(
        self, force: Float64[np.ndarray, "nodes 3"], factors: Float64[np.ndarray, " steps"]
    ) -> Float64[np.ndarray, "steps nodes 3"]:
        """States of equilibrium under growing multiples of dead forces and moments.

        Where Newton's method finds none, the state before is repeated: a search over frames must survive a bad one.
        """
        states: list[Motion] = []
        for step, factor in enumerate(factors):
            motion = self._guess(states, factors, step)
            found = False
            for _ in range(MAX_ITERATIONS):
                held, tangent = self.balance(motion)
                left = (factor * force.ravel() - held)[self.free]
                if np.abs(left).max() <= TOLERANCE * factor * np.abs(force).max():
                    found = True
                    break
                change = np.linalg.solve(tangent[np.ix_(self.free, self.free)], left)
                moved = motion.ravel().copy()
                moved[self.free] += change * min(1.0, _LONGEST_STEP / np.abs(change).max())
                motion = moved.reshape(-1, 3)
            states.append(motion if found or not states else states[-1])
        return np.stack(states)

    def _guess(self, states: list[Motion], factors: Float64[np.ndarray, " steps"], step: int) -> Motion:
        """The line through the last two states."""
        if step == 0:
            return np.zeros((len(self.nodes), 3))
        if step == 1:
            return states[0] * float(factors[1] / factors[0])
        share = float((factors[step] - factors[step - 1]) / (factors[step - 1] - factors[step - 2]))
        along: Motion = states[-1] + share * (states[-1] - states[-2])
        return along
