"""Finite elasticity: quasi-Newton steps around the factor of the body at rest, Newton steps where those are slow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from training.simulation.clamp import Reaction
from training.simulation.factor import NotPositiveDefinite
from training.simulation.loads import Load, nodal_forces
from training.simulation.solution import Solution
from training.simulation.solver import CondensedFactor, LinearSolver

MAX_ITERATIONS = 40
"""Steps of a load step; almost all take under 15."""
MAX_REFACTORED = 5
"""Factors of the tangent in a load step."""
TOLERANCE = 1e-4
"""Residual over load at which a state counts as converged; a 64³ grid shows no difference below 1e-3."""
MIN_JACOBIAN = 0.02
"""States squeezed beyond this volume ratio at a Gauss point are reported as inverted."""
_REFACTOR_COST = 8.0
"""A factor of the tangent takes as long as about this many steps (measured at 24³)."""
_MEMORY = 10
_FIRST_SHIFT = 0.03
"""Share of the stiffness at rest added to a tangent that is not positive definite; three times as much if need be."""
_MAX_SHIFTS = 6
_MAX_HALVINGS = 10
_GIVE_UP_AFTER = 4
"""Steps after which an iterate below the smallest allowed Jacobian has never been seen to recover."""


@dataclass
class _State:
    """One iterate: its displacement over the free degrees of freedom, potential, residual and smallest Jacobian."""

    free: Float64[np.ndarray, " dof"]
    potential: float
    energy: float
    residual: Float64[np.ndarray, " dof"]
    smallest_jacobian: float


def solve_neo_hookean(
    solver: LinearSolver,
    loads: Load | Sequence[Load],
    fractions: Sequence[float] = (1 / 3, 2 / 3, 1.0),
    tolerance: float = TOLERANCE,
    forces: Float64[np.ndarray, "nodes 3"] | None = None,
) -> list[Solution]:
    """Follow a load, or several that act together, up to the full value; every step is a converged state of its own.

    Stops after the first step that fails, whose reason is in the last entry of the list, so that the list may be
    shorter than `fractions`.

    Args:
        solver: Of the body.
        loads: At their full value.
        fractions: Load steps, ascending.
        tolerance: See `TOLERANCE`.
        forces: Nodal forces of the loads, where they are known already.

    Raises:
        LoadError: a load touches no material.
    """
    together = (loads,) if isinstance(loads, Load) else tuple(loads)
    if forces is None:
        forces = nodal_forces(solver.body, together)
    steps = follow_forces(solver, forces, fractions, tolerance)
    return [
        replace(step, loads=tuple(replace(load, load_number=load.load_number * step.fraction) for load in together))
        for step in steps
    ]


def follow_forces(
    solver: LinearSolver,
    forces: Float64[np.ndarray, "nodes 3"],
    fractions: Sequence[float] = (1 / 3, 2 / 3, 1.0),
    tolerance: float = TOLERANCE,
) -> list[Solution]:
    """As `solve_neo_hookean`, for any dead nodal forces, such as the body's own weight."""
    problem = _Problem(solver, forces)
    linear = problem.preconditioner.solve(problem.force)
    solutions: list[Solution] = []
    reached = [(0.0, np.zeros_like(linear))]
    for fraction in fractions:
        if len(reached) == 1:
            guesses = [fraction * linear, 0.3 * fraction * linear]
        else:
            guesses = [_extrapolated(reached[-order:], fraction) for order in range(2, min(len(reached), 3) + 1)]
        state, residuals = problem.equilibrium(fraction, [*guesses, reached[-1][1]], tolerance)
        solution = problem.solution(state, fraction, residuals, tolerance)
        solutions.append(solution)
        if not solution.converged:
            break
        reached.append((fraction, state.free))
    return solutions


def _extrapolated(
    reached: Sequence[tuple[float, Float64[np.ndarray, " dof"]]], fraction: float
) -> Float64[np.ndarray, " dof"]:
    """The polynomial through the states reached so far (Lagrange's form), at another fraction of the load."""
    guess = np.zeros_like(reached[0][1])
    for i, (at, free) in enumerate(reached):
        others = [other for j, (other, _) in enumerate(reached) if j != i]
        guess += np.prod([(fraction - other) / (at - other) for other in others]) * free
    return guess


@dataclass(frozen=True)
class _Pair:
    """A BFGS update: a change of displacement, the change of residual it made, and 1 over their product."""

    change: Float64[np.ndarray, " dof"]
    bend: Float64[np.ndarray, " dof"]
    inverse_product: float


def _left(history: Sequence[float], tolerance: float) -> float:
    """Steps still to go at the present rate of convergence."""
    rate = (history[-1] / history[0]) ** (1.0 / (len(history) - 1)) if len(history) > 1 else 1.0
    return np.inf if rate >= 1.0 else float(np.log(tolerance / history[-1]) / np.log(rate))


class _Problem:
    """Potential energy of one body under one load, and its minimisation."""

    def __init__(self, solver: LinearSolver, force: Float64[np.ndarray, "nodes 3"]) -> None:
        self.solver = solver
        self.body = solver.body
        self.count = len(solver.body.free_dof)
        self.cells = len(solver.body.active)
        # the unknowns are the free displacements and, behind them, the internal parameters of the cells
        self.applied = force
        self.force = np.zeros(self.count + solver.element.internal * self.cells)
        self.force[: self.count] = force.reshape(-1)[self.body.free_dof]
        self.preconditioner = CondensedFactor(solver.body, solver.factor, solver.tangent)
        self.shift = 0.0

    def equilibrium(
        self, fraction: float, guesses: Sequence[Float64[np.ndarray, " dof"]], tolerance: float
    ) -> tuple[_State, list[float]]:
        """Minimise the potential at a fraction of the load from the guess of least potential; the last must be safe.

        Returns the state and the residual before the first and after every iteration.

        Limited-memory BFGS on top of a Cholesky factor: a step costs one evaluation and one solve, about a tenth of a
        Newton step. Where that converges too slowly the tangent is factorised afresh, which is a Newton step.

        Source: Nocedal and Wright, Numerical Optimization (2006), algorithm 7.4; with the factor at rest as initial
        Hessian: Liu, Bouaziz and Kavan, ACM Trans. Graph. 36 (2017).
        """
        force = fraction * self.force
        states = [self.state(guess, force) for guess in guesses[:-1]]
        good = [state for state in states if np.isfinite(state.potential)]
        state = min(good, key=lambda s: s.potential) if good else self.state(guesses[-1], force)
        scale = float(np.linalg.norm(force)) or 1.0
        history = [float(np.linalg.norm(state.residual)) / scale]
        pairs: list[_Pair] = []
        refactored = since = 0
        while history[-1] > tolerance and len(history) <= MAX_ITERATIONS:
            if refactored < MAX_REFACTORED and since >= 2 and _left(history[-3:], tolerance) > _REFACTOR_COST:
                self.refactor(state)
                pairs.clear()
                refactored, since = refactored + 1, 0
            step = -self._inverse_product(pairs, state.residual)
            moved = self._line_search(state, step, force)
            since += 1
            if moved is None:
                if refactored == MAX_REFACTORED or (since == 1 and refactored > 0):
                    break
                self.refactor(state)
                pairs.clear()
                refactored, since = refactored + 1, 0
                continue
            change, bend = moved.free - state.free, moved.residual - state.residual
            product = float(change @ bend)
            if product > 0.0:
                pairs.append(_Pair(change, bend, 1.0 / product))
                del pairs[:-_MEMORY]
            state = moved
            history.append(float(np.linalg.norm(state.residual)) / scale)
            if state.smallest_jacobian < MIN_JACOBIAN and len(history) > _GIVE_UP_AFTER:
                break
        return state, history

    def refactor(self, state: _State) -> None:
        """Factorise the tangent at a state, shifted towards the stiffness at rest until it is positive definite."""
        tangent = self.solver.element.tangent(*self.split(state.free))
        values = self.solver.assemble(tangent.stiffness).data
        # a state close to one that needed a shift needs one too: begin with a part of that
        shift = self.shift / 3.0 if self.shift > _FIRST_SHIFT else 0.0
        for _ in range(_MAX_SHIFTS):
            try:
                self.solver.tangent_factor.refactor(values + shift * self.solver.stiffness.data)
            except NotPositiveDefinite:
                shift = _FIRST_SHIFT if shift == 0.0 else 3.0 * shift
                continue
            self.shift = shift
            self.preconditioner = CondensedFactor(self.body, self.solver.tangent_factor, tangent)
            return
        self.preconditioner = CondensedFactor(self.body, self.solver.factor, self.solver.tangent)

    def state(self, free: Float64[np.ndarray, " dof"], force: Float64[np.ndarray, " dof"]) -> _State:
        """Evaluate potential and residual."""
        element = self.solver.element.evaluate(*self.split(free))
        energy = float(element.energy.sum())
        if not np.isfinite(energy):
            return _State(free, np.inf, np.inf, np.full_like(free, np.inf), element.smallest_jacobian)
        nodal = self.nodal(free)
        hold = self.body.foundation @ nodal
        residual = np.empty_like(free)
        residual[: self.count] = (self.body.scatter(element.forces) + hold).reshape(-1)[self.body.free_dof]
        residual[self.count :] = element.internal_forces.ravel()
        potential = energy + 0.5 * float((nodal * hold).sum()) - float(force @ free)
        return _State(free, potential, energy, residual - force, element.smallest_jacobian)

    def split(
        self, free: Float64[np.ndarray, " dof"]
    ) -> tuple[Float64[np.ndarray, "24 cells"], Float64[np.ndarray, "internal cells"]]:
        """Element displacements and internal parameters of an iterate."""
        return self.body.gather(self.nodal(free)), free[self.count :].reshape(-1, self.cells)

    def nodal(self, free: Float64[np.ndarray, " dof"]) -> Float64[np.ndarray, "nodes 3"]:
        """Displacements of all nodes."""
        full = np.zeros(3 * self.body.nodes)
        full[self.body.free_dof] = free[: self.count]
        return full.reshape(-1, 3)

    def solution(self, state: _State, fraction: float, residuals: Sequence[float], tolerance: float) -> Solution:
        """Judge a state and record it."""
        nodal = self.nodal(state.free)
        inner = self.body.solid_nodes
        moved = self.body.node_positions[inner] + nodal[inner]
        reason = None
        if residuals[-1] > tolerance:
            reason = "not_converged"
        elif state.smallest_jacobian < MIN_JACOBIAN:
            reason = "inverted"
        elif moved.size and (moved.min() < -self.body.cell_edge or moved.max() > 1.0):
            reason = "left_cube"
        unbalanced = np.zeros_like(nodal)
        if self.body.clamped.any():  # what a rigid node carries is known from the elements alone
            element = self.solver.element.evaluate(*self.split(state.free))
            unbalanced = self.body.scatter(element.forces) - fraction * self.applied
        return Solution(
            displacement=nodal,
            parameters=self.split(state.free)[1],
            fraction=fraction,
            loads=(),
            reason=reason,
            iterations=len(residuals) - 1,
            residual=residuals[-1],
            residuals=tuple(residuals),
            smallest_jacobian=state.smallest_jacobian,
            strain_energy=state.energy,
            peak_displacement=float(np.linalg.norm(nodal[inner], axis=1).max(initial=0.0)),
            reaction=Reaction.of(self.body.clamp_forces(nodal, unbalanced), self.body.node_positions + nodal),
        )

    def _inverse_product(
        self, pairs: Sequence[_Pair], vector: Float64[np.ndarray, " dof"]
    ) -> Float64[np.ndarray, " dof"]:
        """Inverse Hessian times a vector: the two-loop recursion around a solve with the present factor."""
        vector = vector.copy()
        scales = []
        for pair in reversed(pairs):
            scale = pair.inverse_product * float(pair.change @ vector)
            vector -= scale * pair.bend
            scales.append(scale)
        vector = self.preconditioner.solve(vector)
        for pair, scale in zip(pairs, reversed(scales), strict=True):
            vector += (scale - pair.inverse_product * float(pair.bend @ vector)) * pair.change
        return vector

    def _line_search(
        self, state: _State, step: Float64[np.ndarray, " dof"], force: Float64[np.ndarray, " dof"]
    ) -> _State | None:
        """Halve the step until the potential falls enough (Armijo); None if it never does."""
        slope = float(state.residual @ step)
        length = 1.0
        for _ in range(_MAX_HALVINGS):
            moved = self.state(state.free + length * step, force)
            # near the minimum rounding hides the decrease; a residual that falls is as good
            if moved.potential <= state.potential + 1e-4 * length * slope or (
                np.linalg.norm(moved.residual) < 0.5 * np.linalg.norm(state.residual)
            ):
                return moved
            length *= 0.5
        return None
