"""Bodies in the unit cube of the simulator, aligned as the service aligns what it reconstructs."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float64

from service.core.alignment import body_grid
from service.core.arrays import GRID_SIZE
from service.core.grids import Grid
from training.simulation.shapes import Shape, to_cube


class BodyCube(NamedTuple):
    """A body in the unit cube.

    Attributes:
        shape: The body there.
        edge: Edge L of the cube in the length unit of the body that was put there.
        cube_from_body: Rotation about z, then scaling by 1/L, then translation, as a 4×4 matrix.
    """

    shape: Shape
    edge: float
    cube_from_body: Float64[np.ndarray, "4 4"]

    def vector(self, body: tuple[float, float, float]) -> Float64[np.ndarray, " 3"]:
        """A direction of the body's own frame, in the cube."""
        return np.asarray(self.edge * self.cube_from_body[:3, :3] @ np.array(body, np.float64))

    def point(self, body: tuple[float, float, float]) -> Float64[np.ndarray, " 3"]:
        """A place in the body's own frame, in the cube."""
        return np.asarray(self.cube_from_body[:3, :3] @ np.array(body, np.float64) + self.cube_from_body[:3, 3])


def place_in_body_grid(shape: Shape) -> BodyCube:
    """Put a body into the unit cube by the very function that aligns what the service reconstructs."""
    low, high = np.asarray(shape.bounds).T
    edge = float((high - low).max()) * 1.02
    pose = np.eye(4)
    pose[:2, 3] = (low + high)[:2] / 2 - edge / 2
    grid = Grid(pitch_m=edge / GRID_SIZE, camera_from_grid=pose)
    aligned = body_grid(occupancy_of(shape, grid), grid)
    shape_from_cube = aligned.camera_from_grid
    rotation = shape_from_cube[:3, :3]
    centre = rotation @ np.array([0.5, 0.5, 0.0]) * aligned.edge_m + shape_from_cube[:3, 3]
    yaw_rad = -float(np.arctan2(shape_from_cube[1, 0], shape_from_cube[0, 0]))
    cube_from_body = np.eye(4)
    cube_from_body[:3, :3] = rotation.T / aligned.edge_m
    cube_from_body[:3, 3] = np.array([0.5, 0.5, 0.0]) - cube_from_body[:3, :3] @ (centre[0], centre[1], 0.0)
    placed = to_cube(shape, yaw_rad, (float(centre[0]), float(centre[1])), 1.0 / aligned.edge_m)
    return BodyCube(placed, aligned.edge_m, cube_from_body)


def occupancy_of(shape: Shape, grid: Grid) -> Bool[np.ndarray, "x=64 y=64 z=64"]:
    """Voxels of a grid whose centres lie inside a shape; the grid's "camera" frame is the shape's own."""
    steps = (np.arange(GRID_SIZE, dtype=np.float32) + 0.5) * np.float32(grid.pitch_m)
    local = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    rotation = grid.camera_from_grid[:3, :3].astype(np.float32)
    points = local @ rotation.T + grid.camera_from_grid[:3, 3].astype(np.float32)
    return (shape.distance(points) < 0).reshape((GRID_SIZE,) * 3)
