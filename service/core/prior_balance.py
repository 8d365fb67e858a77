"""Large deformations: from the linear solution to one in which the material's forces balance the load's.

Arrays of nodes are (loads, 3, n). What one load takes up stays in the cache, so that loads are treated one after the
other. In the kernels even short outer loops run to lengths of arrays: known to the compiler, they would be unrolled.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float32

from service.core.compiled import compiled
from service.core.prior_assembly import rest_factor, solve_at_rest
from service.core.prior_cells import Cells, Nodal, at_corners, gradients, mean_at_nodes
from service.core.prior_forces import missing_forces
from service.core.prior_grid import CellGrid
from service.core.prior_rotation import Matrices, add_identity, polar_rotations, turn, turn_back
from service.core.prior_secant import MEMORY, put_on, remember, take_off
from service.core.prior_twisted import TwistedFactor
from service.core.prior_unrolling import unroll
from service.core.spread import Spread, in_turn
from service.core.vectors import copy, dot

TOLERANCE = np.float32(3e-5)
"""Of the load's work: where the missing forces do less on the next step, a load is balanced. That leaves some half a
percent of the displacement."""

_LEAST_RATIO = np.float32(0.01)
"""Of volumes, at a Gauss point: a step that squeezes a cell further, or turns it inside out, is halved."""

_LONGEST_STEP = np.float32(0.25)
"""Edges of the body grid."""

_TRIES = 8
"""Lengths of a step."""

_GROWTH = np.float32(2.0)
"""Of a step's share beside the one before."""

_HOPEFUL_STEPS = 5
"""Where the missing forces do more work than the load itself after so many steps, these are the last, and the unrolled
linear solution is the answer: of 478 everyday loads, all of which balance, none was there. Such are loads under which
thin walls crumple, and Newton's method takes dozens of factors to balance them, if it does."""

_OVERSHOT = np.float32(-0.5)
"""Work that the missing forces may do against a step after it, as a share of what they did before it."""

_NEARLY = np.float32(0.01)
"""Of the load's work, as `TOLERANCE`: a load whose last step began with more missing is not balanced."""

_FARTHEST = 2.0
"""Edges of the body grid. What moves farther has left the grid; loads that would do so are answered at a share."""

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)

Loads = Float32[np.ndarray, "loads 3 n"]


class NeoHookeanSolver:
    """Displacements of one body under any number of loads.

    Args:
        grid: Its cells.
        poisson_ratio: ν in [0, 0.49].
        spread: Cores for the factor.

    Source: of the law, `service.core.prior_element.Element`; of the steps, `service.core.prior_secant`.
    """

    def __init__(self, grid: CellGrid, poisson_ratio: float, spread: Spread = in_turn) -> None:
        self.cells = Cells.of(grid, poisson_ratio)
        self.factor = rest_factor(self.cells, spread)

    def solve(self, force: Loads, steps: int) -> tuple[Loads, Bool[np.ndarray, " loads"]]:
        """Displacements under nodal forces, and which of them balance.

        Args:
            force: In E L².
            steps: 0 gives the linear solution, which always does. Otherwise that is unrolled and led on until it
                balances to `TOLERANCE`, in at most this many steps.

        Returns:
            Finite values of at most two edges of the grid, whatever the load: one for which nothing finite comes out is
            answered as none. What is cut so does not balance.
        """
        u, balanced = np.empty_like(force), np.ones(len(force), bool)
        solve_at_rest(self.factor, force, u)
        if steps:
            unrolled = np.empty_like(force)
            unroll(self.cells, u, unrolled)
            solve_at_rest(self.factor, unrolled, u)
            for load in range(len(u)):
                balanced[load] = _balance(self.cells, self.factor, force[load], steps, u[load])
        _bound(u, balanced)
        return u, balanced

    def correction(self, u: Loads, force: Loads) -> Loads:
        """About what is missing to balance: the forces left over, by the factor at rest in the frames of the nodes."""
        result = np.empty_like(u)
        for load in range(len(u)):
            _correct(self.cells, self.factor, force[load], u[load], result[load])
        return result


@compiled
def _bound(u: Loads, balanced: Bool[np.ndarray, " loads"]) -> None:
    """Take displacements that go farther than `_FARTHEST` at a share; what is no number is none."""
    for load in range(len(u)):
        values = u[load].ravel()
        longest, finite = np.float32(1e-20), True
        for i in range(len(values)):
            longest = max(longest, abs(values[i]))
            finite &= np.isfinite(values[i])
        share = min(np.float32(1.0), np.float32(_FARTHEST) / longest)
        balanced[load] &= finite and share == np.float32(1.0)
        for i in range(len(values)):
            values[i] = share * values[i] if finite else np.float32(0.0)


@compiled
def _balance(cells: Cells, factor: TwistedFactor, force: Nodal, steps: int, u: Nodal) -> bool:
    """Lead displacements on in their place, by quasi-Newton steps around the factor at rest in the frames of the nodes.

    Each goes as far as the missing forces work for it. Where one leads nowhere, the earlier ones are forgotten and the
    frames taken anew; where the first of such a series leads nowhere, nothing does. False where they do not balance.
    """
    frames, missing, left = np.empty((3, 3, u.shape[1]), np.float32), np.empty_like(u), np.empty_like(u)
    start, place, move, direction = np.empty_like(u), np.empty_like(u), np.empty_like(u), np.empty_like(u)
    moves, changes = np.empty((MEMORY, *u.shape), np.float32), np.empty((MEMORY, *u.shape), np.float32)
    scales, shares = np.empty(MEMORY, np.float32), np.empty(MEMORY, np.float32)
    # the start is a step itself, from rest
    for i in range(len(u)):
        for v in range(u.shape[1]):
            start[i, v], u[i, v] = u[i, v], _ZERO
    if _step(cells, force, u, start, dot(force, start), _ONE, place, missing) > _ZERO:
        copy(place, u)
    else:
        missing_forces(cells, u, force, missing)
    _take_frames(cells, u, frames)
    count, fresh, largest, nearly = 0, True, _ONE, False
    for step in range(steps):
        copy(missing, left)
        take_off(moves, changes, scales, count, shares, left)
        _solve_in_frames(factor, frames, left, direction)
        put_on(moves, changes, scales, count, shares, direction)
        work = dot(missing, direction)
        total = abs(dot(force, u))
        if _ZERO < work <= TOLERANCE * total:
            return True
        nearly = bool(abs(work) <= _NEARLY * total)
        if step == _HOPEFUL_STEPS and work > total:
            if missing_forces(cells, start, force, left) > _LEAST_RATIO:
                copy(start, u)
            return False
        share = _ZERO
        if work > _ZERO:
            largest = min(largest, _LONGEST_STEP / _longest(direction))
            share = _step(cells, force, u, direction, work, largest, place, left)
        if share > _ZERO:
            largest = min(_ONE, _GROWTH * share)
            for i in range(len(u)):
                for v in range(u.shape[1]):
                    move[i, v] = place[i, v] - u[i, v]
                    u[i, v], direction[i, v], missing[i, v] = place[i, v], missing[i, v] - left[i, v], left[i, v]
            count, fresh = remember(move, direction, moves, changes, scales, count), False
        elif fresh:
            return nearly
        else:
            _take_frames(cells, u, frames)
            count, fresh, largest = 0, True, _ONE
    return nearly


@compiled
def _step(
    cells: Cells, force: Nodal, u: Nodal, direction: Nodal, work: np.float32, largest: np.float32, place: Nodal,
    missing: Nodal,
) -> np.float32:
    """Go along a direction until the missing forces, written anew, do not push back by much; the share that is gone.

    None where no share tried does.
    """
    share = largest
    for _ in range(_TRIES):
        for i in range(len(u)):
            for v in range(u.shape[1]):
                place[i, v] = u[i, v] + share * direction[i, v]
        if not missing_forces(cells, place, force, missing) > _LEAST_RATIO:
            share *= np.float32(0.5)
            continue
        after = dot(missing, direction)
        if after >= _OVERSHOT * work:
            return share
        share *= max(min(work / (work - after), np.float32(0.7)), np.float32(0.1))
    return _ZERO


@compiled
def _longest(values: Nodal) -> np.float32:
    longest = np.float32(1e-20)
    for i in range(len(values)):
        for v in range(values.shape[1]):
            longest = max(longest, abs(values[i, v]))
    return longest


@compiled
def _correct(cells: Cells, factor: TwistedFactor, force: Nodal, u: Nodal, result: Nodal) -> None:
    """See `NeoHookeanSolver.correction`."""
    missing, frames = np.empty_like(u), np.empty((3, 3, u.shape[1]), np.float32)
    missing_forces(cells, u, force, missing)
    _take_frames(cells, u, frames)
    _solve_in_frames(factor, frames, missing, result)


@compiled
def _take_frames(cells: Cells, u: Nodal, frames: Matrices) -> None:
    """Rotations of the material around the nodes."""
    k = cells.nodes.shape[1]
    corners, rotation = np.empty((8, 3, k), np.float32), np.empty((3, 3, k), np.float32)
    at_corners(cells, u, corners)
    gradients(cells, corners, rotation)
    add_identity(rotation)
    polar_rotations(rotation)
    mean_at_nodes(cells, rotation, frames)
    polar_rotations(frames)


@compiled
def _solve_in_frames(factor: TwistedFactor, frames: Matrices, force: Nodal, result: Nodal) -> None:
    """Displacements by the factor at rest, turned with the material."""
    turned = np.empty((1, *force.shape), np.float32)
    turn_back(frames, force, turned[0])
    solve_at_rest(factor, turned, turned)
    turn(frames, turned[0], result)
