"""The paper's partial views: every body seen from 125 rotations, 5 about each axis, by a camera without noise.

Source: Wang et al., "3D-PhysNet" (IJCAI 2018), section 4.1; 400 bodies by 125 views are its 50,000 samples.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field

import numpy as np

from service.core.arrays import GRID_SIZE, Matrix3, Transform
from service.core.camera import Intrinsics, back_project
from service.core.grids import Grid, invert_rigid, pack_bits
from service.core.voxels import carve_free, view_axes, voxelize_points
from training.data.body_cube import occupancy_of
from training.data.paper import PaperConfig, bridge
from training.simulation.camera import render
from training.simulation.shapes import Shape

SIZE_PX = 128
"""Edge of the image: two pixels a voxel."""


@dataclass(frozen=True)
class PartialViewsConfig:
    """What is seen.

    Attributes:
        bodies: The bridges and their stretches.
        angles: Rotations about each axis, evenly spaced over the full turn.
        room: Edge of the view grid over the diameter of the body: it holds the body however it is turned.
    """

    bodies: PaperConfig = field(default_factory=PaperConfig)
    angles: int = 5
    room: float = 1.1


def rotations(angles: int) -> list[Matrix3]:
    """About x, then y, then z, by all combinations of evenly spaced angles."""
    turns = 2.0 * math.pi * np.arange(angles) / angles
    return [_turn(2, c) @ _turn(1, b) @ _turn(0, a) for a, b, c in itertools.product(turns, repeat=3)]


def _turn(axis: int, angle: float) -> Matrix3:
    i, j = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[i, i] = matrix[j, j] = math.cos(angle)
    matrix[i, j], matrix[j, i] = -math.sin(angle), math.sin(angle)
    return matrix


def draw_group(config: PartialViewsConfig, index: int) -> dict[str, np.ndarray]:
    """One body in all its views, laid out as in the `views` set; `sample` is the view and the body's diameter."""
    shape = bridge(config.bodies.entry(index).stretch)
    diameter_m = float(np.linalg.norm(shape.bounds[:, 1] - shape.bounds[:, 0]))
    columns: dict[str, list[np.ndarray]] = {"observed": [], "free": [], "truth": []}
    for rotation in rotations(config.angles):
        for name, bits in _view(shape, rotation, diameter_m, config.room).items():
            columns[name].append(bits)
    return {
        "family": np.array("bridge"),
        **{name: np.stack(rows) for name, rows in columns.items()},
        "sample": np.array([[number, diameter_m] for number in range(config.angles**3)], np.float32),
    }


def _view(shape: Shape, rotation: Matrix3, diameter_m: float, room: float) -> dict[str, np.ndarray]:
    """The bits of one view."""
    distance_m = 3.0 * diameter_m
    focal = 0.9 * SIZE_PX * distance_m / (room * diameter_m)
    intrinsics = Intrinsics(fx=focal, fy=focal, cx=SIZE_PX / 2, cy=SIZE_PX / 2, width=SIZE_PX, height=SIZE_PX)
    camera_from_world: Transform = np.eye(4)
    camera_from_world[:3, :3] = rotation
    camera_from_world[:3, 3] = np.array([0.0, 0.0, distance_m]) - rotation @ shape.bounds.mean(axis=1)
    rendering = render(shape, camera_from_world, intrinsics, plane=False, farthest_m=math.inf)
    # x away from the camera and z up in the image, as in the grids of other views
    camera_from_grid = view_axes(np.array([0.0, -1.0, 0.0]))
    edge_m = room * diameter_m
    corner = camera_from_grid[:3, :3] @ np.full(3, -edge_m / 2)
    camera_from_grid[:3, 3] = np.array([0.0, 0.0, distance_m]) + corner
    grid = Grid(edge_m / GRID_SIZE, camera_from_grid)
    observed = voxelize_points(back_project(rendering.depth_m, intrinsics, rendering.mask), grid)
    # a ray that meets nothing has crossed everything
    depth_m = np.where(np.isfinite(rendering.depth_m), rendering.depth_m, np.float32(np.inf))
    free = carve_free(depth_m, intrinsics, grid) & ~observed
    truth = occupancy_of(shape, Grid(grid.pitch_m, invert_rigid(camera_from_world) @ camera_from_grid))
    return {"observed": pack_bits(observed), "free": pack_bits(free), "truth": pack_bits(truth)}
