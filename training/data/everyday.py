"""The `everyday` set: bodies of many families under pushes of any place and direction, solved by finite elements."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float16, Float32, UInt8

from service.core.alignment import body_grid
from service.core.arrays import GRID_SIZE, Occupancy, Vector3
from service.core.condition import POISSON_RATIO_MAX
from service.core.grids import Grid, pack_bits
from training.data.generate import Dropped
from training.metrics import iou
from training.simulation.body import Body, BodyError
from training.simulation.families import FAMILIES, sample_shape
from training.simulation.force_search import force_for_identity_iou
from training.simulation.loads import Load, LoadError
from training.simulation.newton import solve_neo_hookean
from training.simulation.rasterise import Rasterised, Rasteriser
from training.simulation.shapes import Shape, min_thickness, to_cube
from training.simulation.solver import LinearSolver

FIELD_SIZE = 32
"""Nodes along each edge of the stored displacement field."""

SEARCH_SIZE = 32
"""Voxels along an edge while the force is searched for."""


@dataclass(frozen=True)
class EverydayConfig:
    """What is drawn for each body.

    Attributes:
        seed: Group i draws from SeedSequence((seed, i)), so that the set does not depend on who computes what.
        cells: Cells along an edge of the simulation grid.
        thickness: Thinnest member that is simulated, in cells: three, less what the measurement may be off by.
        loads: Pushes on each body.
        identity_iou: The largest load of each push deforms the body until the IoU with itself at rest falls to a
            value drawn uniformly from this range; a fixed range of forces would make a trivial set.
        fractions: Load steps of the nonlinear solution, each of them a sample.
        small_fraction: One more, linear sample at a share of the first step drawn log-uniformly from this range, so
            that a network also sees small deformations.
        patch_radius: Range of the patch radius, in edges of the grid.
        inward: Range of the mixture between a uniformly random direction (0) and straight into the surface (1).
    """

    seed: int = 0
    cells: int = 24
    thickness: float = 2.8
    loads: int = 3
    identity_iou: tuple[float, float] = (0.30, 0.85)
    fractions: tuple[float, ...] = (1 / 3, 2 / 3, 1.0)
    small_fraction: tuple[float, float] = (0.01, 0.5)
    patch_radius: tuple[float, float] = (0.08, 0.20)
    inward: tuple[float, float] = (0.0, 0.8)


def place_in_body_grid(shape: Shape) -> Shape:
    """The shape in the unit cube, aligned by the very function that aligns what the service reconstructs."""
    low, high = np.asarray(shape.bounds).T
    edge = float((high - low).max()) * 1.02
    pose = np.eye(4)
    pose[:2, 3] = (low + high)[:2] / 2 - edge / 2
    grid = Grid(pitch_m=edge / GRID_SIZE, camera_from_grid=pose)
    aligned = body_grid(occupancy_of(shape, grid), grid)
    shape_from_cube = aligned.camera_from_grid
    centre = shape_from_cube[:3, :3] @ np.array([0.5, 0.5, 0.0]) * aligned.edge_m + shape_from_cube[:3, 3]
    yaw_rad = -float(np.arctan2(shape_from_cube[1, 0], shape_from_cube[0, 0]))
    return to_cube(shape, yaw_rad, (float(centre[0]), float(centre[1])), 1.0 / aligned.edge_m)


def occupancy_of(shape: Shape, grid: Grid) -> Bool[np.ndarray, "x=64 y=64 z=64"]:
    """Voxels of a grid whose centres lie inside a shape; the grid's "camera" frame is the shape's own."""
    steps = (np.arange(GRID_SIZE, dtype=np.float32) + 0.5) * np.float32(grid.pitch_m)
    local = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    rotation = grid.camera_from_grid[:3, :3].astype(np.float32)
    points = local @ rotation.T + grid.camera_from_grid[:3, 3].astype(np.float32)
    return (shape.distance(points) < 0).reshape((GRID_SIZE,) * 3)


def draw_group(config: EverydayConfig, index: int) -> dict[str, np.ndarray]:
    """One body with all its samples.

    Returns:
        `rest` bits, `family`, and one row a sample of `condition` (9), `deformed` bits, `displacement` (3, 32³,
        float16, edges of the grid), `coverage` (32³, eighths of a node's cell inside the deformed body), `peak`,
        `identity_iou`, `law`, and `sample` (load number within the body, step).

    Raises:
        Dropped: The draw gives no sample at all.
    """
    rng = np.random.default_rng(np.random.SeedSequence((config.seed, index)))
    family = FAMILIES[rng.integers(len(FAMILIES))]
    try:
        shape = place_in_body_grid(sample_shape(family, rng))
    except RuntimeError as error:  # no body of the family stood in as many tries as it is given
        raise Dropped("no_shape") from error
    if min_thickness(shape) < config.thickness / config.cells:
        raise Dropped("thin")
    try:
        body = Body.from_distance(shape.distance, config.cells)
        contacts, normals = body.surface_points(config.loads, rng)
    except BodyError as error:
        raise Dropped(error.reason) from error
    solver = LinearSolver(body, float(rng.uniform(0.0, POISSON_RATIO_MAX)))
    fine, rough = Rasteriser(body), Rasteriser(body, SEARCH_SIZE)
    samples: list[dict[str, Any]] = []
    for number, (contact, normal) in enumerate(zip(contacts, normals, strict=True)):
        unit = Load(contact, _direction(rng, normal, config.inward), 1.0, float(rng.uniform(*config.patch_radius)))
        target = float(rng.uniform(*config.identity_iou))
        small = config.fractions[0] * float(np.exp(rng.uniform(*np.log(config.small_fraction))))
        try:
            linear = solver.solve([unit])[0]
        except LoadError:
            continue
        load = force_for_identity_iou(rough, unit, linear, target)
        if load is None:
            continue
        states = [("linear", small, small * load.load_number * linear)]
        states += [
            ("neo_hookean", fraction, step.displacement)
            for fraction, step in zip(config.fractions, solve_neo_hookean(solver, load, config.fractions), strict=False)
            if step.converged
        ]
        for law, fraction, displacement in states:
            condition = [
                *load.contact, *load.direction, np.log10(fraction * load.load_number),
                solver.poisson_ratio, load.patch_radius,
            ]  # fmt: skip
            samples.append(_row(fine.rest, fine(displacement), condition, law, number, fraction))
    if not samples:
        raise Dropped("no_solution")
    columns = {key: np.stack([sample[key] for sample in samples]) for key in samples[0]}
    return {"rest": pack_bits(fine.rest), "family": np.array(family), **columns}


def _direction(rng: np.random.Generator, normal: Vector3, inward: tuple[float, float]) -> Vector3:
    random = rng.normal(size=3)
    random /= np.linalg.norm(random)
    share = rng.uniform(*inward)
    direction = (1 - share) * random - share * normal
    return np.asarray(direction / np.linalg.norm(direction))


def _row(
    rest: Occupancy, result: Rasterised, condition: list[float], law: str, number: int, fraction: float
) -> dict[str, Any]:
    displacement, coverage = coarsen(result.backward)
    return {
        "condition": np.array(condition, np.float32),
        "deformed": pack_bits(result.deformed),
        "displacement": displacement,
        "coverage": coverage,
        "peak": np.float32(result.peak_displacement),
        "identity_iou": np.float32(iou(rest, result.deformed)),
        "law": np.array(law),
        "sample": np.array([number, round(fraction, 4)], np.float32),
    }


def coarsen(
    backward: Float32[np.ndarray, "axis=3 x=64 y=64 z=64"],
) -> tuple[Float16[np.ndarray, "axis=3 x=32 y=32 z=32"], UInt8[np.ndarray, "x=32 y=32 z=32"]]:
    """Mean over the voxels of each node's cell that lie in the deformed body, and how many of the eight do."""
    inside = np.isfinite(backward[0])
    split = (FIELD_SIZE, 2) * 3
    coverage = inside.reshape(split).sum(axis=(1, 3, 5)).astype(np.uint8)
    total = np.where(inside, backward, 0.0).reshape(3, *split).sum(axis=(2, 4, 6))
    return (total / np.maximum(coverage, 1)).astype(np.float16), coverage
