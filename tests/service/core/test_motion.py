import numpy as np
import pytest

from service.core.motion import motion
from tests.service.fields import at_voxels, bent


def test_motion_is_the_field_in_the_deformed_body_in_metres() -> None:
    rng = np.random.default_rng(7)
    rest, deformed = rng.random((2, 64, 64, 64)) < 0.1
    deformed[:, 20:23] = deformed[5] = False
    field = bent(2)
    moved = motion(field, rest, 0.4 + 0.2 * deformed.astype(np.float32), 0.5, 0.3)
    np.testing.assert_array_equal(moved.deformed, deformed)
    expected = 0.3 * at_voxels(field, rest)[:, deformed]
    np.testing.assert_allclose(moved.moved_m, expected, atol=1e-7)
    lengths_m = np.linalg.norm(expected, axis=0)
    assert moved.max_m == pytest.approx(lengths_m.max(), rel=1e-5)
    assert moved.mean_m == pytest.approx(lengths_m.mean(), rel=1e-5)


def test_nothing_has_not_moved() -> None:
    nothing = np.zeros((64, 64, 64), np.float32)
    moved = motion(bent(3), nothing > 0.5, nothing, 0.5, 0.3)
    assert not moved.deformed.any()
    assert (moved.max_m, moved.mean_m) == (0.0, 0.0)
    assert moved.moved_m.shape == (3, 0)


def test_what_stands_on_the_floor_does_not_move() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[10:20, 10:20, :5] = True
    everywhere = np.ones(rest.shape, np.float32)
    moved_m = motion(np.ones((3, 32, 32, 32), np.float32), rest, everywhere, 0.5, 1.0).moved_m.reshape(3, 64, 64, 64)
    assert not moved_m[:, 10:20, 10:20, 0].any()
    assert moved_m[:, 9, 10, 0].all()
    assert moved_m[:, :, :, 1:].all()
