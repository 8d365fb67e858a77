"""Where a mesh goes in the cube."""

from __future__ import annotations

import numpy as np
import pytest

from tests.training.simulation.cases import OFFSET_M, bar_triangles, below
from training.simulation.placement import Box, Placement


def nodes_off(placement: Placement, point_m: np.ndarray) -> np.ndarray:
    """How far each coordinate of a point is from the nearest plane of nodes, in cells."""
    place = placement.to_cube(point_m[None])[0] * placement.cells
    return np.abs(place - place.round())


def test_there_and_back_is_the_identity() -> None:
    placement = Placement.of(bar_triangles(), 24, 0.74)
    points = np.random.default_rng(0).uniform(-1, 1, (50, 3))
    np.testing.assert_allclose(placement.to_metres(placement.to_cube(points)), points, atol=1e-14)


def test_on_the_ground_the_lowest_point_is_at_zero_and_the_rest_centred() -> None:
    placement = Placement.of(bar_triangles(axis=2), 16, 0.75)
    box = placement.to_cube(bar_triangles(axis=2)).reshape(-1, 3)
    # 12 of 16 cells high, 3 wide: 6 or 7 cells of room on either side.
    np.testing.assert_allclose(box.min(axis=0) * 16, [6, 6, 0], atol=1e-9)
    np.testing.assert_allclose(box.max(axis=0) * 16, [9, 9, 12], atol=1e-9)


@pytest.mark.parametrize("cells", [13, 24, 31])
@pytest.mark.parametrize("fill", [0.3, 0.74, 0.96])
@pytest.mark.parametrize("held", [(), (below(0, OFFSET_M[0] + 0.0137),), (below(1, OFFSET_M[1]),)])
def test_flat_ends_and_the_clamps_border_lie_on_planes_of_nodes(cells: int, fill: float, held: tuple[Box, ...]) -> None:
    triangles = bar_triangles()
    placement = Placement.of(triangles, cells, fill, held)
    box = placement.to_cube(triangles).reshape(-1, 3)
    assert box.min() > -1e-9
    assert box.max() < 1 + 1e-9
    border = OFFSET_M.copy()
    if held and np.isfinite(held[0].high[0]):
        border[0] = held[0].high[0]
    assert nodes_off(placement, border).max() < 1e-6
    if not held:
        assert nodes_off(placement, OFFSET_M + np.array([0.08, 0, 0]))[0] < 1e-6


def test_regions_take_in_the_faces_on_their_border_and_add_up() -> None:
    held = (below(0, OFFSET_M[0]), Box(OFFSET_M + np.array([0.06, 0, 0]), OFFSET_M + np.array([0.07, 0.02, 0.02])))
    placement = Placement.of(bar_triangles(), 24, 0.74, held)
    region = placement.regions(held)
    assert region is not None
    offsets = np.array([[1e-5, 0.01, 0.01], [1e-3, 0.01, 0.01], [0.065, 0.02, 0.01], [0.075, 0.02, 0.01]])
    assert region(placement.to_cube(OFFSET_M + offsets)).tolist() == [True, False, True, False]
    assert placement.regions(()) is None


def test_forces_scale_with_modulus_and_area() -> None:
    placement = Placement.of(bar_triangles(), 16, 0.75)
    assert placement.edge_m == pytest.approx(0.08 / 0.75)
    assert placement.force_unit_n(2e6) == pytest.approx(2e6 * (0.08 / 0.75) ** 2)
