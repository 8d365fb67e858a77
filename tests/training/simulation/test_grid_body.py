"""Bodies sampled on a grid against the functions they were sampled from."""

from __future__ import annotations

import numpy as np
import pytest

from service.core.camera import Intrinsics
from service.core.grids import Grid
from training.data.body_cube import occupancy_of
from training.simulation.camera import look_at, render
from training.simulation.families import sample_shape
from training.simulation.grid_body import filled, sampled, scaled, tipped
from training.simulation.shapes import Shape, stand, tight_bounds
from training.simulation.shapes.primitives import Box, Cylinder, Sphere

CAMERA = Intrinsics(fx=600.0, fy=610.0, cx=318.0, cy=242.0, width=640, height=480)
POSE = look_at((2.6, 1.1, 1.9), (0, 0, 0.4))
CUBE = np.eye(4)
CUBE[:3, 3] = (-0.8, -0.8, -0.1)
VIEW = Grid(pitch_m=1.6 / 64, camera_from_grid=CUBE)


@pytest.mark.parametrize("family", ["mug", "chair", "plush", "csg"])
def test_a_sampled_body_looks_and_fills_as_the_function_does(family: str) -> None:
    """Walls of 2 to 4 % of the edge among them; edges are rounded by a fraction of a cell, 1 % of the body."""
    shape = sample_shape(family, np.random.default_rng(3), thin=True)
    grid = sampled(shape)
    exact, looked = render(shape, POSE, CAMERA), render(Shape(family, grid), POSE, CAMERA)
    assert exact.mask.sum() > 10_000
    assert (exact.mask ^ looked.mask).sum() < 0.02 * exact.mask.sum()
    both = exact.mask & looked.mask
    error = np.abs(exact.depth_m[both] - looked.depth_m[both])
    assert np.median(error) < 3e-4
    assert np.quantile(error, 0.98) < 0.01
    truth, found = occupancy_of(shape, VIEW), filled(grid, VIEW)
    assert (truth ^ found).sum() < 0.01 * truth.sum()


def test_the_box_of_a_sampled_body_is_its_own_to_half_a_cell() -> None:
    for family in ("bowl", "animal", "tower"):
        shape = sample_shape(family, np.random.default_rng(5), thin=True).stretched((1.1, 0.9, 1.3))
        tight, found = tight_bounds(shape), sampled(shape).bounds
        assert np.abs(tight - found).max() < 0.5 / 96 * (tight[:, 1] - tight[:, 0]).max()


def test_a_body_behind_something_nearer_or_the_camera_is_not_met() -> None:
    ball = Shape("ball", sampled(Shape("ball", Sphere(0.3).shift(z=0.3))))
    wall = stand("wall", Box((0.05, 2.0, 1.5))).moved(translation=(1.2, 0.0, 0.0))
    assert render(ball, POSE, CAMERA).mask.sum() > 1000
    assert not render(ball, POSE, CAMERA, clutter=[wall]).mask.any()
    assert not render(ball, look_at((2, 0, 1), (4, 0, 1)), CAMERA).mask.any()


def test_scaling_scales_depth_and_box() -> None:
    grid = sampled(stand("box", Box((0.5, 0.3, 0.2))))
    small = scaled(grid, 0.1)
    np.testing.assert_allclose(small.bounds, 0.1 * grid.bounds)
    near, far = look_at((0.2, 0.1, 0.2), (0, 0, 0.02)), look_at((2, 1, 2), (0, 0, 0.2))
    tiny, large = (render(Shape("box", body), pose, CAMERA) for body, pose in ((small, near), (grid, far)))
    assert (tiny.mask ^ large.mask).sum() < 0.005 * large.mask.sum()
    both = tiny.mask & large.mask
    np.testing.assert_allclose(10 * tiny.depth_m[both], large.depth_m[both], atol=2e-3)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_a_tipped_body_stands_on_the_ground_and_is_turned_about_x(turns: int) -> None:
    """A cone-like pair of cylinders, broad below: upside down the broad one is above, lying it points along y."""
    shape = stand("pawn", Cylinder(0.4, 0.2) | Cylinder(0.15, 0.4).shift(x=0.1, z=0.6))
    body = tipped(sampled(shape), turns)
    turned = stand("pawn", shape.field.turn("x", turns * np.pi / 2))
    np.testing.assert_allclose(body.bounds, tight_bounds(turned), atol=0.008)
    truth, found = occupancy_of(turned, VIEW), filled(body, VIEW)
    assert (truth ^ found).sum() < 0.03 * truth.sum()
    assert not tipped(sampled(shape), 0).values.tobytes() == body.values.tobytes()


def test_walls_that_the_grid_cannot_show_are_refused() -> None:
    with pytest.raises(ValueError, match=r"thin|empty"):
        sampled(Shape("sheet", Box((0.5, 0.5, 0.0002)).turn("y", 0.3)), cells=24)
