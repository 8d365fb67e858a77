"""Large rotations: every cell is linearly elastic in a frame that turns with it.

Arrays of nodes are (loads, 3, n). What one load takes up stays in the cache, so that loads are treated one after the
other. In the kernels even short outer loops run to lengths of arrays: known to the compiler, they would be unrolled.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32

from service.core.compiled import compiled
from service.core.prior_assembly import rest_factor, solve_at_rest
from service.core.prior_cells import (
    Cells,
    Corners,
    add_bed,
    at_corners,
    at_nodes,
    cell_forces,
    gradients,
    mean_at_nodes,
)
from service.core.prior_factor import BandFactor
from service.core.prior_grid import CellGrid
from service.core.prior_rotation import (
    add_identity,
    exponentials,
    polar_rotations,
    spin_axes,
    turn,
    turn_back,
)
from service.core.prior_secant import next_places

_LARGEST_ROTATION = np.float32(1.3)
"""Radians. A cantilever under a dead load turns towards the load, by π/2 at the very most."""

TOLERANCE = 3e-5
"""Of the load's work: a correction on which the missing forces do less is the last. That leaves some half a percent of
the displacement; most samples of `everyday` need five to eight corrections, what bends far up to two dozen."""

SHORT_STEP = 0.01
"""Of the farthest node's displacement. Where the missing forces do more work than the load, cells hang by a thread or
are turned inside out, and never balance: there a step that is short is the last. Elsewhere it says little, as steps are
short where corrections do not prove right."""

_FARTHEST = 2.0
"""Edges of the body grid. What moves farther has left the grid; loads that would do so are answered at a share."""

Loads = Float32[np.ndarray, "loads 3 n"]
Places = Float32[np.ndarray, "steps loads 3 n"]


class CorotationalSolver:
    """Displacements of one body under any number of loads.

    Args:
        grid: Its cells.
        poisson_ratio: ν in [0, 0.49].

    Source: corotational cells: Müller and Gross, Interactive Virtual Materials (2004). Rotation from the linear
    solution: Huang et al., Interactive shape interpolation through rotation-strain coordinates, TVCG 17 (2011).
    """

    def __init__(self, grid: CellGrid, poisson_ratio: float) -> None:
        self.cells = Cells.of(grid, poisson_ratio)
        self.factor = rest_factor(self.cells)

    def solve(self, force: Loads, steps: int) -> Loads:
        """Displacements under nodal forces.

        Args:
            force: In E L².
            steps: 0 gives the linear solution. Otherwise that is unrolled and corrected, see `prior_secant`, until it
                balances to `TOLERANCE`, at most this many times.

        Returns:
            Finite values of at most two edges of the grid, whatever the load: one for which nothing finite comes out is
            answered as none.
        """
        u = np.empty_like(force)
        solve_at_rest(self.factor, force, u)
        if steps:
            unrolled = np.empty_like(force)
            _unroll(self.cells, u, unrolled)
            solve_at_rest(self.factor, unrolled, u)
            self._balance(u, force, steps)
        _bound(u)
        return u

    def _balance(self, u: Loads, force: Loads, steps: int) -> None:
        """Correct displacements in their place; each load is left alone once it balances."""
        places = np.empty((steps + 1, *u.shape), np.float32)
        directions = np.empty((steps, *u.shape), np.float32)
        places[0], moving = u, np.arange(len(u))
        for step in range(steps):
            left = np.empty(len(moving), np.bool_)
            count = _advance(self.cells, self.factor, places, directions, step, force, left)
            if count < len(moving):
                u[moving[~left]] = places[step + 1, ~left]
                if count == 0:
                    return
                moving, force = moving[left], force[left]
                places, directions = (np.ascontiguousarray(each[:, left]) for each in (places, directions))
        u[moving] = places[steps]

    def correction(self, u: Loads, force: Loads) -> Loads:
        """About what is missing to balance: the forces left over, by the factor at rest in the frames of the nodes."""
        result = np.empty_like(u)
        _correct(self.cells, self.factor, u, force, result, np.empty(len(u), np.float32))
        return result


@compiled
def _bound(u: Loads) -> None:
    """Take displacements that go farther than `_FARTHEST` at a share; what is no number is none."""
    for load in range(len(u)):
        values = u[load].ravel()
        longest, finite = np.float32(1e-20), True
        for i in range(len(values)):
            longest = max(longest, abs(values[i]))
            finite &= np.isfinite(values[i])
        share = min(np.float32(1.0), np.float32(_FARTHEST) / longest)
        for i in range(len(values)):
            values[i] = share * values[i] if finite else np.float32(0.0)


@compiled
def _unroll(cells: Cells, displacement: Loads, result: Loads) -> None:
    """The forces that belong to linear solutions with the rotations of their cells made finite.

    A cell's displacement without its mean and its infinitesimal rotation ω is turned by exp(ω); under these forces the
    elastic energy of what the cells then miss is least. A load that would turn a cell farther than dead loads do is
    taken at a share: linear elasticity winds a body up without end.
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
def _correct(
    cells: Cells, factor: BandFactor, u: Loads, force: Loads, result: Loads, work: Float32[np.ndarray, " loads"]
) -> None:
    """See `CorotationalSolver.correction`; tells the work of the missing forces on it, too."""
    k = cells.nodes.shape[1]
    corners, local = np.empty((8, 3, k), np.float32), np.empty((8, 3, k), np.float32)
    rotation, frames = np.empty((3, 3, k), np.float32), np.empty((len(u), 3, 3, u.shape[2]), np.float32)
    missing, left = np.empty_like(u[0]), np.empty_like(u)
    for load in range(len(u)):
        at_corners(cells, u[load], corners)
        gradients(cells, corners, rotation)
        _add_rest(cells, np.float32(1.0), corners)
        add_identity(rotation)
        polar_rotations(rotation)
        for a in range(len(corners)):
            turn_back(rotation, corners[a], local[a])
        _add_rest(cells, np.float32(-1.0), local)
        cell_forces(cells, local, corners)
        for a in range(len(corners)):
            turn(rotation, corners[a], local[a])
        at_nodes(cells, local, missing)
        add_bed(cells, u[load], missing)
        for i in range(len(missing)):
            row, applied = missing[i], force[load, i]
            for v in range(len(row)):
                row[v] = applied[v] - row[v]
        mean_at_nodes(cells, rotation, frames[load])
        polar_rotations(frames[load])
        turn_back(frames[load], missing, left[load])
    solved = np.empty_like(left)
    solve_at_rest(factor, left, solved)
    for load in range(len(u)):
        turn(frames[load], solved[load], result[load])
        forces, moves, total = left[load].ravel(), solved[load].ravel(), np.float32(0.0)
        for i in range(len(forces)):
            total += forces[i] * moves[i]
        work[load] = total


@compiled
def _advance(
    cells: Cells, factor: BandFactor, places: Places, directions: Places, step: int, force: Loads,
    left: Bool[np.ndarray, " loads"],
) -> int:  # fmt: skip
    """One more correction of every load: tell which need another one, and how many.

    One that is no number needs none.
    """
    missing = np.empty(len(force), np.float32)
    _correct(cells, factor, places[step], force, directions[step], missing)
    next_places(places, directions, step)
    count = 0
    for load in range(len(force)):
        now, after, applied = places[step, load].ravel(), places[step + 1, load].ravel(), force[load].ravel()
        work, moved, farthest = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for i in range(len(now)):
            work += applied[i] * now[i]
            moved = max(moved, abs(after[i] - now[i]))
            farthest = max(farthest, abs(after[i]))
        work = abs(work)
        balanced = not missing[load] > np.float32(TOLERANCE) * work
        lost = not missing[load] < work and not moved > np.float32(SHORT_STEP) * farthest
        left[load] = not (balanced or lost)
        count += left[load]
    return count


@compiled
def _add_rest(cells: Cells, times: np.float32, corners: Corners) -> None:
    """From displacements of the corners to their places, or back."""
    for a in range(len(corners)):
        for i in range(corners.shape[1]):
            row, rest = corners[a, i], times * cells.rest[a, i]
            for c in range(len(row)):
                row[c] += rest
