"""What travels over `/v1/live`, as arrays."""

from __future__ import annotations

import numpy as np
import pytest

from service.api.live_frames import NOTHING, answer_parts
from service.core.grids import Grid
from service.core.messages import DeformResult, LoadResult

STILL = np.zeros((3, 64, 64, 64), np.float32)


def result_of(
    deformed: np.ndarray, displacement_m: np.ndarray, rest: np.ndarray, probability: np.ndarray | None = None
) -> DeformResult:
    probability = rest.astype(np.float32) if probability is None else probability
    largest_m = float(np.sqrt((displacement_m**2).sum(0)).max())
    moved_m = displacement_m[:, deformed]
    load = LoadResult(deformed, deformed.astype(np.float32), moved_m, largest_m, 0.0, 0.0, frozenset())
    return DeformResult(Grid(0.003, np.eye(4)), None, rest, probability, (load,), frozenset(), "fake", "1")


def block(low: tuple[int, int, int], high: tuple[int, int, int]) -> np.ndarray:
    occupancy = np.zeros((64, 64, 64), bool)
    occupancy[tuple(slice(a, b) for a, b in zip(low, high, strict=True))] = True
    return occupancy


def test_a_cell_holds_the_mean_of_its_voxels_that_are_filled():
    deformed = block((10, 20, 0), (13, 24, 7))  # its last voxels along x share their cells with empty ones
    field = np.zeros((3, 64, 64, 64), np.float32)
    field[0] = np.arange(64, dtype=np.float32)[:, None, None] * 1e-3
    field *= deformed
    part = answer_parts(result_of(deformed, field, deformed), False, 0.5)["displacement"]
    assert part.origin == (8, 18, 0)
    assert part.array.shape == (3, 4, 4, 5)
    x_mm = part.array[0, :, 1, 0] * part.scale * 1e3
    assert part.array[0, 0, 1, 0] == NOTHING
    assert x_mm[1] == pytest.approx(10.5, abs=1e-3)
    assert x_mm[2] == pytest.approx(12.0, abs=1e-3)
    assert (part.array[1:, 1:3, 1:3, :3] == 0).all()


def test_a_body_at_the_rim_of_the_grid_is_whole():
    whole = np.ones((64, 64, 64), bool)
    parts = answer_parts(result_of(whole, STILL, whole), True, 0.5)
    assert parts["rest"].array.shape == (64, 64, 64)
    assert parts["displacement"].array.shape == (3, 32, 32, 32)
    assert set(parts) == {"rest", "displacement"}


def test_an_empty_body_is_sent_as_one():
    empty = np.zeros((64, 64, 64), bool)
    parts = answer_parts(result_of(empty, STILL, empty), True, 0.5)
    assert (parts["displacement"].array == NOTHING).all()
    assert (parts["rest"].array == 0).all()


def test_a_voxel_filled_for_being_observed_lies_above_the_threshold():
    rest = block((10, 10, 0), (20, 20, 10))
    probability = np.where(rest, np.float32(0.9), np.float32(0.1)).astype(np.float32)
    rest[30, 30, 5] = True
    part = answer_parts(result_of(rest, STILL, rest, probability), True, 0.45)["rest"]
    x, y, z = part.origin
    assert part.array[30 - x, 30 - y, 5 - z] == 255
    assert part.array[15 - x, 15 - y, 5 - z] == round(0.9 * 255)
