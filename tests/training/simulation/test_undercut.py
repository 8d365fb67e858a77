"""Bodies drawn together towards the ground."""

from __future__ import annotations

import numpy as np
import pytest

from service.core.camera import Intrinsics
from service.core.grids import Grid
from training.simulation.camera import look_at, render
from training.simulation.grid_body import filled, sampled
from training.simulation.shapes import Shape, stand
from training.simulation.shapes.primitives import Box, Cylinder, Sphere
from training.simulation.undercut import foot, stands, undercut

CAMERA = Intrinsics(fx=600.0, fy=610.0, cx=318.0, cy=242.0, width=640, height=480)
POSE = look_at((2.6, 1.1, 1.9), (0, 0, 0.4))
CUBE = np.eye(4)
CUBE[:3, 3] = (-0.8, -0.8, -0.1)
VIEW = Grid(pitch_m=1.6 / 64, camera_from_grid=CUBE)


def test_an_undercut_body_is_narrower_below_and_as_before_above() -> None:
    """A square section of 1.0 by 0.8 whose foot loses two fifths: at z it is 1 − 0.4 (1 − z/0.3)² of it across."""
    grid = sampled(stand("block", Box((0.5, 0.4, 0.3))))
    body = undercut(grid, 0.4, 0.3)
    assert body.bounds.tolist() == grid.bounds.tolist()
    volume = filled(body, VIEW).sum(axis=(0, 1)) * VIEW.pitch_m**2
    heights = (np.arange(64) + 0.5) * VIEW.pitch_m - 0.1
    within = (heights > 0.01) & (heights < 0.59)
    expected = 0.8 * (1.0 - 0.4 * np.clip(1.0 - heights / 0.3, 0.0, 1.0) ** 2) ** 2
    np.testing.assert_allclose(volume[within], expected[within], rtol=0.05)
    # no value is more than a distance: a ray that advances by it does not pass through
    for axis in range(3):
        assert np.abs(np.diff(body.values, axis=axis)).max() <= 1.05 * np.abs(np.diff(grid.values, axis=axis)).max()
    assert 0.3 < foot(body).sum() / foot(grid).sum() < 0.42
    looked = render(Shape("block", body), POSE, CAMERA)
    assert looked.mask.sum() < render(Shape("block", grid), POSE, CAMERA).mask.sum()


def test_what_hangs_in_the_air_has_no_foot_to_undercut() -> None:
    with pytest.raises(ValueError, match="does not stand"):
        undercut(sampled(Shape("ball", Sphere(0.3).shift(z=0.6))), 0.3, 0.2)


def test_what_leans_over_the_rest_of_its_foot_does_not_stand() -> None:
    """A mast at one end of a plate: drawn together towards the middle of the plate, the foot leaves the mast behind."""
    leaning = sampled(stand("mast", Box((0.5, 0.3, 0.03)) | Cylinder(0.12, 0.8).shift(x=0.36, z=0.8)))
    assert stands(undercut(leaning, 0.1, 0.1), leaning)
    assert not stands(undercut(leaning, 0.6, 0.1), leaning)
