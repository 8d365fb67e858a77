"""What of a mask is kept as its object."""

from __future__ import annotations

import numpy as np

from service.core.strays import without_background

UP = np.array([0.0, -1.0, 0.0])


def _patch(x_m: float, z_m: float, side_m: float, points: int) -> np.ndarray:
    spread = np.random.default_rng(1).uniform(-side_m / 2, side_m / 2, (points, 3))
    return (np.array([x_m, 0.0, z_m]) + spread).astype(np.float32)


def test_background_behind_the_object_is_left_out() -> None:
    thing, wall = _patch(0.0, 0.8, 0.1, 2000), _patch(0.0, 1.5, 0.1, 400)
    kept = without_background(np.concatenate([thing, wall]), UP)
    assert kept[:2000].all()
    assert not kept[2000:].any()


def test_a_part_near_the_object_is_kept_and_a_few_readings_there_are_not() -> None:
    thing, part, stray = _patch(0.0, 0.8, 0.1, 2000), _patch(0.0, 0.94, 0.02, 100), _patch(0.12, 0.8, 0.005, 5)
    kept = without_background(np.concatenate([thing, part, stray]), UP)
    assert kept[:2100].all()
    assert not kept[2100:].any()
