"""What a model must beat: no motion, the mean shape, interpolation between known answers, coarse finite elements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Float32, Float64, Int, UInt8
from scipy import ndimage, spatial

from service.core.arrays import GRID_SIZE, Occupancy
from training.simulation.body import Body
from training.simulation.loads import Load
from training.simulation.newton import solve_neo_hookean
from training.simulation.rasterise import Rasterised, Rasteriser
from training.simulation.solver import LinearSolver

Distance: TypeAlias = Callable[[Float32[np.ndarray, "n 3"]], Float32[np.ndarray, " n"]]
"""Signed distance to a surface, negative inside, for points in cube coordinates."""

GRID = (GRID_SIZE,) * 3
EXACT = 1e-9
"""Conditions nearer than this are the same one: its answer is known."""


def identity(rest: UInt8[np.ndarray, "n bytes"]) -> Float32[np.ndarray, "n x y z"]:
    """Nothing moves."""
    return _unpack(rest)


def mean_shape(deformed: UInt8[np.ndarray, "n bytes"]) -> Float32[np.ndarray, "x y z"]:
    """Share of the training answers that fill each voxel: what one knows without having looked at anything."""
    total = np.zeros(GRID, np.float64)
    for bits in deformed:
        total += _unpack(bits[None])[0]
    return (total / len(deformed)).astype(np.float32)


@dataclass(frozen=True)
class NearestNeighbours:
    """Inverse-distance interpolation between the answers whose conditions are nearest (Shepard's method).

    Knows nothing of the body: where there is one body, as in the authors' release, it is hard to beat.

    Attributes:
        condition: Of the training samples.
        deformed: Bits of their answers.
        scale: Distances are measured in condition·scale.
        count: How many neighbours are interpolated, if there are as many; 1 copies the nearest answer.

    Source: Shepard, ACM National Conference 1968, with power 1.
    """

    condition: Float[np.ndarray, "n fields"]
    deformed: UInt8[np.ndarray, "n bytes"]
    scale: Float[np.ndarray, " fields"]
    count: int = 4

    def weights(
        self, condition: Float[np.ndarray, "b fields"]
    ) -> tuple[Int[np.ndarray, "b k"], Float64[np.ndarray, "b k"]]:
        """Rows of the neighbours and their weights, which sum to one."""
        tree = spatial.cKDTree((self.condition * self.scale).astype(np.float64))
        distance, row = tree.query((condition * self.scale).astype(np.float64), k=min(self.count, len(self.condition)))
        distance = np.asarray(distance).reshape(len(condition), -1)  # one neighbour comes without an axis
        row = np.asarray(row).reshape(len(condition), -1)
        weight = 1.0 / np.maximum(distance, EXACT)
        return row, weight / weight.sum(axis=1, keepdims=True)

    def __call__(self, condition: Float[np.ndarray, "b fields"]) -> Float32[np.ndarray, "b x y z"]:
        """Interpolated occupancy for each condition."""
        rows, weights = self.weights(condition)
        answers = [np.tensordot(w, _unpack(self.deformed[r]), axes=1) for r, w in zip(rows, weights, strict=True)]
        return np.stack(answers).astype(np.float32)


class LinearFem:
    """Linear elasticity on a coarse grid of finite elements: what an engineer in a hurry would run.

    Args:
        rest: The body at rest, all that a robot has of it.
        cells: Cells along an edge of the cube.

    Raises:
        BodyError: The body does not stand on the floor, or is thinner than the cells can show.
    """

    def __init__(self, rest: Occupancy, cells: int) -> None:
        self._body = Body.from_distance(distance_of(rest), cells)
        self._rasteriser = Rasteriser(self._body)
        self._solvers: dict[float, LinearSolver] = {}

    def __call__(self, condition: Float32[np.ndarray, " 9"]) -> Rasterised:
        """The body under one load, as served (`service.core.condition`).

        Raises:
            LoadError: The load touches no material.
        """
        return self._rasteriser(self._displacement(self._solver(float(condition[7])), _load(condition)))

    def _displacement(self, solver: LinearSolver, load: Load) -> Float64[np.ndarray, "nodes 3"]:
        displacement: Float64[np.ndarray, "nodes 3"] = solver.solve([load])[0]
        return displacement

    def _solver(self, poisson_ratio: float) -> LinearSolver:
        if poisson_ratio not in self._solvers:
            self._solvers[poisson_ratio] = LinearSolver(self._body, poisson_ratio)
        return self._solvers[poisson_ratio]


class NeoHookeanFem(LinearFem):
    """The same by the law that the data obeys, in three load steps; as far as they converge."""

    def _displacement(self, solver: LinearSolver, load: Load) -> Float64[np.ndarray, "nodes 3"]:
        steps = [step for step in solve_neo_hookean(solver, load) if step.converged]
        return steps[-1].displacement if steps else np.zeros_like(solver.body.node_positions)


def _load(condition: Float32[np.ndarray, " 9"]) -> Load:
    contact, direction = condition[:3].astype(np.float64), condition[3:6].astype(np.float64)
    return Load(contact, direction, float(10.0 ** condition[6]), float(condition[8]))


def distance_of(occupancy: Occupancy) -> Distance:
    """Signed distance to the surface of a voxel grid, in edges of the grid, interpolated between the voxel centres.

    The surface passes half-way between the last voxel inside and the first outside; on the floor, where the grid ends,
    the body goes on below, as one that stands there does.
    """
    if not occupancy.any() or occupancy.all():
        raise ValueError("there is no distance to the surface of nothing, nor of everything")
    outside = ndimage.distance_transform_edt(~occupancy)
    inside = ndimage.distance_transform_edt(occupancy)
    signed = (np.where(occupancy, 0.5 - inside, outside - 0.5) / GRID_SIZE).astype(np.float32)

    def distance(points: Float32[np.ndarray, "n 3"]) -> Float32[np.ndarray, " n"]:
        place = np.asarray(points, np.float32).T * GRID_SIZE - 0.5
        return np.asarray(ndimage.map_coordinates(signed, place, order=1, mode="nearest"), np.float32)

    return distance


def _unpack(bits: UInt8[np.ndarray, "n bytes"]) -> Float32[np.ndarray, "n x y z"]:
    voxels: Bool[np.ndarray, "n voxels"] = np.unpackbits(bits, axis=1, bitorder="little")
    return voxels.reshape(-1, *GRID).astype(np.float32)
