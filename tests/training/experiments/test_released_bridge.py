"""The frame of the released bridge on bridges that it drew itself."""

from functools import cache

import numpy as np
import pytest

from training.experiments.released_bridge import (
    LEVELS,
    BridgeModel,
    Geometry,
    fit_bridge,
    frame,
    measure,
    overlaps,
    raster,
    shapes,
    terms,
)

BRIDGE = Geometry(left=11.6, right=52.3, bottom=36.7, top=39.2, inset=7.8, half_width=1.4, foot=23.0)
LOAD = np.array([0.9, 3.0, 0.0, 0.3, 0.1, 0.0])


def section_at_rest() -> np.ndarray:
    return shapes(BRIDGE, np.array([-9.0]))[0][0]


@cache
def drawn() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A body at rest, 20 deformed ones and their labels: eight layers wide."""
    stiffness, poisson = np.meshgrid(np.linspace(0, 1, 10), [0.2, 0.8], indexing="ij")
    label = np.stack([stiffness.ravel(), poisson.ravel()], axis=1).astype(np.float32)
    grid = np.zeros((21, 64, 64, 64), bool)
    grid[0, :, 28:36] = section_at_rest()[:, None]
    grid[1:, :, 28:36] = BridgeModel(BRIDGE, LOAD).shapes(label)[0][:, :, None]
    return grid[0], grid[1:], label


def test_a_bridge_is_measured_to_a_voxel() -> None:
    found = measure(section_at_rest())
    np.testing.assert_allclose(found[:7], BRIDGE[:7], atol=0.7)


def test_hardly_loaded_it_looks_as_at_rest_and_loaded_more_it_moves_more() -> None:
    section, strain = shapes(BRIDGE, np.array([-9.0, -1.0, 0.0, 1.0]))
    assert np.abs(strain[0]).max() < 0.01
    overlap = overlaps(section, section[:1])[0]
    assert overlap[0] == 1.0
    assert (np.diff(overlap) < -0.05).all()
    lowest = [np.argwhere(part[48:])[:, 1].mean() for part in section]
    assert (np.diff(lowest) < -0.3).all()  # the end that is pressed


def test_the_deck_is_stretched_above_and_pressed_together_below_the_right_pier() -> None:
    """As any cantilever under a force at its end."""
    _, strain = shapes(BRIDGE, np.array([0.0]))
    over = strain[0, round(BRIDGE.right - BRIDGE.inset) + 2]
    filled = np.flatnonzero(over)
    assert over[filled[-1]] > 0.005
    assert over[filled[0]] < -0.005


def test_piers_are_as_stiff_as_they_are_thick() -> None:
    """Bending goes with the cube of the thickness, stretching with the thickness itself."""
    thick, _ = frame(BRIDGE._replace(half_width=2.5))
    stiff, _ = frame(BRIDGE._replace(half_width=2.5, stiffness=1.0))
    bending, axial = thick.bending * thick.length, thick.axial * thick.length
    assert bending[-1] / bending[0] == pytest.approx(8.0)
    assert axial[-1] / axial[0] == pytest.approx(2.0)
    assert stiff.bending[-1] / thick.bending[-1] == pytest.approx(np.e)
    np.testing.assert_array_equal(stiff.axial, thick.axial)


def test_voxels_whose_centres_are_covered_are_filled() -> None:
    """A rectangle from 3.2 to 7.6 and 2.0 to 3.5, stretched by a tenth above and not at all below."""
    corners = np.array([[[3.2, 2.0], [7.6, 2.0], [7.6, 3.5], [3.2, 3.5]]])
    rest = corners.copy()
    rest[0, 2, 0] = 7.2
    section, strain = raster(corners[None], rest)
    assert np.argwhere(section[0]).tolist() == [[x, z] for x in range(4, 7) for z in (2, 3)] + [[7, 2], [7, 3]]
    assert strain[0, 5, 2] == pytest.approx(0.0, abs=1e-6)
    assert strain[0, 5, 3] == pytest.approx(0.1 / 1.5, abs=1e-6)


def test_what_is_beyond_the_grid_is_left_out() -> None:
    corners = np.array([[[[-2.0, 62.5], [0.5, 62.5], [0.5, 65.0], [-2.0, 65.0]]]])
    section, _ = raster(corners, corners[0])
    assert np.argwhere(section[0]).tolist() == [[0, 63]]


def test_a_stiff_body_has_a_small_load_number() -> None:
    level = terms(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]], np.float32)) @ LOAD
    np.testing.assert_allclose(level, [0.9, -2.1, 0.5])


def test_the_search_comes_near_the_bridge_that_was_drawn() -> None:
    rest, deformed, label = drawn()
    stiff = slice(6, None)
    fitted = fit_bridge(label[stiff], deformed[stiff, :, 30], rest[:, 30], sweeps=1)
    known = overlaps(fitted.shapes(label)[0], deformed[:, :, 30]).diagonal()
    assert known[stiff].mean() > 0.93
    assert known[:6].mean() > 0.8  # softer than all that it has seen
    assert LEVELS[0] < fitted.load_number(label).min() < fitted.load_number(label).max() < LEVELS[-1]
