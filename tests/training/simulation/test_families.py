"""Every family stands, fits its bounds, is thick enough to simulate, and repeats from its seed."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from training.simulation.families import FAMILIES, sample_shape, stands
from training.simulation.shapes import min_thickness, stand, tight_bounds, voxelize
from training.simulation.shapes.primitives import Box, CappedCone
from training.simulation.shapes.shape import sample_points

CELL = 1 / 24
"""Of the simulator's grid; members are to be three of them thick."""


def test_at_least_twenty_families_and_the_papers_own() -> None:
    assert len(FAMILIES) >= 20
    assert len(set(FAMILIES)) == len(FAMILIES)
    assert {"bridge", "cylinder", "L", "T", "U", "table", "tower", "mug", "bottle", "bowl", "plush"} <= set(FAMILIES)


@pytest.mark.parametrize("thin", [False, True], ids=["solid", "thin"])
@pytest.mark.parametrize("family", FAMILIES)
def test_stands_on_the_ground_in_one_piece(family: str, thin: bool) -> None:
    shape = sample_shape(family, np.random.default_rng(11), thin)
    assert shape.family == family
    box = tight_bounds(shape)
    assert box[2, 0] == pytest.approx(0, abs=2e-3)
    # Centred on the z axis, about 1 wide.
    extent = box[:, 1] - box[:, 0]
    assert np.abs(box[:2].mean(axis=1)).max() < 0.02 * extent.max()
    assert 0.3 < extent.max() < 4.0
    assert 0.05 < extent[2] / extent[:2].max() < 3.2
    occupancy, pitch, region = voxelize(shape, 40, box)
    assert occupancy[:, :, 0].sum() >= 0.015 * occupancy[:, :, 0].size
    labels, _ = ndimage.label(occupancy, np.ones((3, 3, 3), int))
    assert np.bincount(labels.ravel())[1:].max() >= 0.99 * occupancy.sum()
    # Nothing below the ground.
    below = sample_points(region, occupancy.shape)
    below[:, 2] = -1e-3
    assert (shape.distance(below[:2000]) > 0).all()
    # Voxels from blocks are the voxels from points.
    every = shape.distance(sample_points(region, occupancy.shape)).reshape(occupancy.shape) < 0
    assert np.array_equal(every, occupancy)
    assert pitch > 0


@pytest.mark.parametrize("family", FAMILIES)
def test_no_step_of_the_field_leads_through_the_surface(family: str) -> None:
    """|d(p) − d(q)| ≤ 1.05·|p − q| outside: the slack is for the gauge of ellipsoids."""
    shape = sample_shape(family, np.random.default_rng(12))
    rng = np.random.default_rng(0)
    box = shape.bounds + np.array([-0.3, 0.3])
    p = rng.uniform(box[:, 0], box[:, 1], (3000, 3)).astype(np.float32)
    q = p + rng.normal(0, 0.02, p.shape).astype(np.float32)
    dp, dq = shape.distance(p), shape.distance(q)
    outside = (dp > 0) & (dq > 0)
    ratio = np.abs(dp - dq)[outside] / np.linalg.norm(p - q, axis=1)[outside]
    assert ratio.max() < 1.05


def test_most_solid_bodies_are_three_cells_thick() -> None:
    """The rest is rejected by whoever makes a data set, and counted."""
    rng = np.random.default_rng(13)
    thickness = np.array([min_thickness(sample_shape(family, rng), resolution=40) for family in FAMILIES[::2]])
    assert (thickness >= 3 * CELL - 0.005).mean() > 0.8


@pytest.mark.parametrize("family", ["mug", "bowl", "cup", "vase"])
def test_thin_vessels_are_hollow_with_thin_walls(family: str) -> None:
    shape = sample_shape(family, np.random.default_rng(14), thin=True)
    assert min_thickness(shape) < 0.06
    # Open above: looking down the axis from the top, more than half of the height is air.
    height = tight_bounds(shape)[2, 1]
    axis = np.zeros((50, 3), np.float32)
    axis[:, 2] = np.linspace(0, height, 50)
    assert (shape.distance(axis) > 0).mean() > 0.5


def test_the_same_seed_gives_the_same_body_and_another_one_another() -> None:
    first, again, other = (sample_shape("csg", np.random.default_rng(seed)) for seed in (1, 1, 2))
    assert first == again
    assert first != other


def test_an_unknown_family_lists_the_known_ones() -> None:
    with pytest.raises(KeyError, match=r"teapot.*bridge"):
        sample_shape("teapot", np.random.default_rng(0))


def test_stands_refuses_what_floats_falls_or_comes_apart() -> None:
    cube = Box((0.5, 0.5, 0.5))
    assert stands(stand("cube", cube))
    assert not stands(stand("two", cube | cube.shift(x=2)))
    assert not stands(stand("overhang", Box((0.1, 0.1, 0.5)) | Box((1, 0.5, 0.2)).shift(1.0, 0, 0.7)))
    assert not stands(stand("cube", cube).moved(translation=(0, 0, 0.1)))
    assert not stands(stand("top", CappedCone(0.02, 1.0, 0.5)))
