"""The columns of a group of deformation samples: one body at rest, and what became of it under each load."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from service.core.arrays import Occupancy
from service.core.condition import Condition
from service.core.grids import pack_bits
from training.data.fields import Field, Nodes, block_means, coarsen, extend, pack_fields, pack_nodes
from training.metrics import iou
from training.simulation.clamp import Reaction
from training.simulation.loads import Load, load_cases
from training.simulation.rasterise import Rasterised, Rasteriser
from training.simulation.solution import Solution
from training.simulation.solver import LinearSolver
from training.simulation.stress import linear_von_mises, von_mises

LENGTHS_M = (0.05, 0.40)
"""Edges L of the body grid that bodies without a size of their own are given, drawn log-uniformly: what stands on a
table. Only E, F and L as numbers depend on it, the deformation does not."""

YOUNG_MAX_PA = 23e9
"""The paper's upper bound, that of concrete (section 3.5)."""


@dataclass(frozen=True)
class Material:
    """What makes a load number out of a force: F = Λ E L².

    Attributes:
        young_modulus_pa: Young's modulus E.
        poisson_ratio: ν.
        edge_m: Edge L of the body grid.
    """

    young_modulus_pa: float
    poisson_ratio: float
    edge_m: float

    def force_n(self, load_number: float) -> float:
        """The force that a load number stands for."""
        return load_number * self.young_modulus_pa * self.edge_m**2


class Outcome(NamedTuple):
    """What the solver says of a state.

    Attributes:
        law: `linear` or `neo_hookean`.
        strain_energy: In units of E L³.
        smallest_jacobian: Smallest volume ratio in the body; NaN where the law is linear, which knows none.
        reaction: Of the clamp.
        von_mises: Stress at the voxels of the body at rest, in units of E.
        iterations: Of the step that led here; 0 where the law is linear.
        residual: Unbalanced forces over the load at its end; NaN where the law is linear.
    """

    law: str
    strain_energy: float
    smallest_jacobian: float
    reaction: Reaction
    von_mises: Float64[np.ndarray, " k"]
    iterations: int = 0
    residual: float = np.nan


@dataclass(frozen=True)
class Sample:
    """One deformed body.

    Attributes:
        deformed: Its voxels.
        backward: u(y) on nodes of the deformed body and a little beyond.
        backward_nodes: Where that is.
        forward: u(x) on nodes of the body at rest and a little beyond.
        forward_nodes: Where that is.
        von_mises: Stress on nodes of the body at rest, of the largest.
        numbers: Every scalar column by name.
        law: `linear` or `neo_hookean`.
    """

    deformed: Occupancy
    backward: Field
    backward_nodes: Nodes
    forward: Field
    forward_nodes: Nodes
    von_mises: Float64[np.ndarray, "x=32 y=32 z=32"]
    numbers: dict[str, np.ndarray]
    law: str

    @classmethod
    def of(
        cls,
        rest: Occupancy,
        result: Rasterised,
        load: Load,
        material: Material,
        outcome: Outcome,
        number: tuple[int, float],
        location: tuple[int, float] = (-1, np.nan),
    ) -> Sample:
        """Gather what is stored of one state.

        Args:
            rest: The body at rest.
            result: The state on voxels.
            load: The load, with the load number of this state.
            material: Gives the force its newtons.
            outcome: What the solver says of it.
            number: Number of the load within the body, and the part of its full force.
            location: Of the force along the top, as the paper encodes it: which of how many, and from 0 to 1; −1 and
                NaN where it is anywhere.
        """
        backward, covered = coarsen(result.deformed_at, result.moved_here)
        forward, at_rest = coarsen(result.at_rest, result.moved_from)
        backward, backward_nodes = extend(backward, covered > 0)
        forward, forward_nodes = extend(forward, at_rest > 0)
        stress = block_means(result.at_rest, outcome.von_mises)
        largest = float(stress.max())
        numbers = {
            "condition": condition_of(load, material.poisson_ratio),
            "peak": np.float32(result.peak_displacement),
            "identity_iou": np.float32(iou(rest, result.deformed)),
            "strain_energy": np.float32(outcome.strain_energy),
            "smallest_jacobian": np.float32(outcome.smallest_jacobian),
            "peak_von_mises": np.float32(largest),
            "convergence": np.array([outcome.iterations, outcome.residual], np.float32),
            "reaction": np.concatenate([outcome.reaction.force, outcome.reaction.moment]).astype(np.float32),
            "young_modulus_pa": np.float64(material.young_modulus_pa),
            "force_n": np.float64(material.force_n(load.load_number)),
            "location": np.array(location, np.float32),
            "sample": np.array([number[0], round(number[1], 4)], np.float32),
        }
        arrays = {key: np.asarray(value) for key, value in numbers.items()}
        share = stress / max(largest, np.finfo(np.float64).tiny)
        return cls(result.deformed, backward, backward_nodes, forward, forward_nodes, share, arrays, outcome.law)


@dataclass(frozen=True)
class State:
    """Makes samples of one push on one body.

    Attributes:
        rasteriser: Of the body, at 64³.
        material: Of the body.
        number: Of the push within the body.
        location: Of the push along the top, see `Sample.of`.
    """

    rasteriser: Rasteriser
    material: Material
    number: int
    location: tuple[int, float] = (-1, np.nan)

    def linear(self, load: Load, unit: Response, fraction: float) -> Sample:
        """The linear answer to a load, from that to the same load of unit strength."""
        displacement = load.load_number * unit.displacement
        # Clapeyron: the work of a load on a linear body is twice the energy it stores.
        energy = 0.5 * load.load_number * float((unit.forces * displacement).sum())
        carried = Reaction.of(-load.load_number * unit.forces, self.rasteriser.body.node_positions)
        stress = self.rasteriser.at_rest(load.load_number * unit.von_mises)
        outcome = Outcome("linear", energy, np.nan, carried, stress)
        return self._sample(displacement, load, outcome, fraction)

    def nonlinear(self, solver: LinearSolver, solution: Solution) -> Sample:
        """A converged step under one load."""
        (load,) = solution.loads
        stress = self.rasteriser.at_rest(von_mises(solver, solution))
        outcome = Outcome(
            "neo_hookean", solution.strain_energy, solution.smallest_jacobian, solution.reaction, stress,
            solution.iterations, solution.residual,
        )  # fmt: skip
        return self._sample(solution.displacement, load, outcome, solution.fraction)

    def _sample(
        self, displacement: Float64[np.ndarray, "nodes 3"], load: Load, outcome: Outcome, fraction: float
    ) -> Sample:
        result = self.rasteriser(displacement)
        number = (self.number, fraction)
        return Sample.of(self.rasteriser.rest, result, load, self.material, outcome, number, self.location)


class Response(NamedTuple):
    """Nodal forces of a load of unit strength, and the linear displacements and stresses under them."""

    forces: Float64[np.ndarray, "nodes 3"]
    displacement: Float64[np.ndarray, "nodes 3"]
    von_mises: Float64[np.ndarray, " cells"]


def respond(solver: LinearSolver, units: Sequence[Load]) -> list[Response]:
    """Linear responses to loads of unit strength, right-hand sides of one factor.

    Raises:
        LoadError: A load touches no material.
    """
    forces = load_cases(solver.body, units)
    moved = solver.solve_forces(forces)
    return [Response(force, u, linear_von_mises(solver, u)) for force, u in zip(forces, moved, strict=True)]


def scaled(load: Load, factor: float) -> Load:
    """A load times a number."""
    return replace(load, load_number=factor * load.load_number)


def condition_of(load: Load, poisson_ratio: float) -> Condition:
    """The condition vector, as the service encodes it, of a load in the body grid."""
    values = [*load.contact, *load.direction, np.log10(load.load_number), poisson_ratio, load.patch_radius]
    return np.array(values, np.float32)


def group_of(family: str, rest: Occupancy, edge_m: float, samples: Sequence[Sample]) -> dict[str, np.ndarray]:
    """The arrays of a group.

    Returns:
        `rest` (32768 bytes of bits), `family`, `edge_m`, `nodes` (4096 bytes of bits over 32³ nodes: the k nodes near
        any body of the group), and one row a sample of `deformed` bits, `displacement` (backward) and `forward`
        (float16, 3 × k, edges of the grid), `von_mises` (float16, k, of `peak_von_mises`), `law` and every scalar
        column.
    """
    nodes = np.logical_or.reduce([s.backward_nodes | s.forward_nodes for s in samples])
    return {
        "rest": pack_bits(rest),
        "family": np.array(family),
        "edge_m": np.array(edge_m),
        "nodes": pack_nodes(nodes),
        "deformed": np.stack([pack_bits(s.deformed) for s in samples]),
        "displacement": pack_fields([s.backward for s in samples], nodes),
        "forward": pack_fields([s.forward for s in samples], nodes),
        "von_mises": np.stack([s.von_mises[nodes] for s in samples]).astype(np.float16),
        "law": np.array([s.law for s in samples]),
        **{key: np.stack([s.numbers[key] for s in samples]) for key in samples[0].numbers},
    }
