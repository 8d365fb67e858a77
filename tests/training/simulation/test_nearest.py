"""Nearest points of a box, which are known."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from training.simulation.nearest import nearest_on_surface


@pytest.mark.parametrize(
    ("point", "foot", "distance_m"),
    [
        ([0.1, 0.2, 3.0], [0.1, 0.2, 1.0], 2.0),  # over a face
        ([2.0, 2.0, 0.3], [1.0, 1.0, 0.3], 2**0.5),  # beside an edge
        ([2.0, 2.0, 2.0], [1.0, 1.0, 1.0], 3**0.5),  # at a corner
        ([0.9, 0.0, 0.1], [1.0, 0.0, 0.1], 0.1),  # inside
    ],
)
def test_nearest_point_of_a_box(point: list[float], foot: list[float], distance_m: float) -> None:
    box = np.asarray(trimesh.creation.box((2.0, 2.0, 2.0)).triangles, np.float64)
    nearest = nearest_on_surface(box, np.array(point))
    np.testing.assert_allclose(nearest.point_m, foot, atol=1e-12)
    assert nearest.distance_m == pytest.approx(distance_m)
