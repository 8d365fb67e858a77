"""Distances of closed surfaces against the true ones."""

from __future__ import annotations

import numpy as np
import trimesh

from training.simulation.distance_grid import distance_grid


def ball(radius: float = 0.1) -> trimesh.Trimesh:
    return trimesh.creation.icosphere(subdivisions=4, radius=radius)


def test_a_ball_has_the_distances_of_a_ball() -> None:
    grid = distance_grid(np.asarray(ball().triangles, np.float64), resolution=64)
    points = np.random.default_rng(0).uniform(-0.13, 0.13, (4000, 3)).astype(np.float32)
    x, y, z = points.T.copy()
    value, true = grid.at(x, y, z), np.linalg.norm(points, axis=1) - 0.1
    pitch = 0.2 / 64
    near = np.abs(true) < 1.5 * pitch
    # The facets of this ball lie up to 0.1 % of its radius below it, and interpolation adds a little.
    assert np.abs(value - true)[near].max() < 3e-4
    assert (np.abs(value) <= np.abs(true) + 3e-4).all()
    assert (np.sign(value) == np.sign(true))[np.abs(true) > 3e-4].all()
    within = (np.abs(points) < 0.1).all(axis=1)
    assert np.abs(value - true)[within].max() < 2 * pitch


def test_far_from_the_grid_the_value_is_a_useful_lower_bound() -> None:
    grid = distance_grid(np.asarray(ball().triangles, np.float64), resolution=32)
    points = np.random.default_rng(1).normal(0, 0.5, (500, 3)).astype(np.float32)
    x, y, z = points.T.copy()
    value, true = grid.at(x, y, z), np.linalg.norm(points, axis=1) - 0.1
    outside = true > 0.05
    assert (value <= true + 1e-3)[outside].all()
    assert (value > 0.3 * true)[outside].all()
