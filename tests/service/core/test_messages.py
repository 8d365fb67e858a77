import numpy as np

from service.core.messages import LoadResult


def test_a_displacement_is_at_its_voxels_and_zero_elsewhere() -> None:
    rng = np.random.default_rng(0)
    deformed = rng.random((64, 64, 64)) < 0.1
    moved_m = rng.normal(size=(3, int(deformed.sum()))).astype(np.float32)
    load = LoadResult(deformed, deformed.astype(np.float32), moved_m, 0.0, 0.0, 0.0, frozenset())
    expected = np.zeros((3, 64, 64, 64), np.float32)
    expected[:, deformed] = moved_m
    np.testing.assert_array_equal(load.displacement_m, expected)
    assert load.as_grid(moved_m.astype(np.float16)).dtype == np.float16
