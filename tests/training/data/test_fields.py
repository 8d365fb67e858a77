"""Fields on nodes: averaged inside, carried on outside, kept where they are."""

import numpy as np
import pytest
from scipy import ndimage

from training.data.fields import block_means, coarsen, extend, pack_fields, pack_nodes, unpack_fields, unpack_nodes

CENTRES = (np.indices((32, 32, 32), dtype=np.float32) + 0.5) / 32


def ball(radius: float) -> np.ndarray:
    return ((CENTRES - 0.5) ** 2).sum(axis=0) < radius**2


def at(*places: tuple[int, int, int]) -> np.ndarray:
    return np.ravel_multi_index(tuple(np.array(places).T), (64, 64, 64))


def test_coarsening_averages_inside_only() -> None:
    index = at((10, 20, 30), (11, 20, 30), (63, 0, 63))
    values = np.array([[0.1, 0.2, 0.3], [0.5, 0.5, 0.5], [1.0, 2.0, 3.0]], np.float32)
    field, covered = coarsen(index, values)
    assert covered[5, 10, 15] == 2
    assert covered.sum() == 3
    np.testing.assert_allclose(field[:, 5, 10, 15], [0.3, 0.35, 0.4], atol=1e-6)
    np.testing.assert_array_equal(field[:, 31, 0, 31], [1.0, 2.0, 3.0])


def test_a_scalar_is_averaged_over_the_voxels_of_a_block() -> None:
    index = at((10, 20, 30), (11, 20, 30), (63, 0, 63))
    means = block_means(index, np.array([0.1, 0.5, 2.0]))
    assert means[5, 10, 15] == pytest.approx(0.3)
    assert means[31, 0, 31] == 2.0
    assert np.count_nonzero(means) == 2


def test_coverage_counts_voxels_of_each_block() -> None:
    filled = np.random.default_rng(0).random((64, 64, 64)) < 0.5
    index = np.flatnonzero(filled)
    _, covered = coarsen(index, np.ones((len(index), 3), np.float32))
    np.testing.assert_array_equal(covered, filled.reshape(32, 2, 32, 2, 32, 2).sum(axis=(1, 3, 5)))


def test_a_field_is_kept_inside_and_carried_on_by_two_layers() -> None:
    known = ball(0.25)
    field = np.where(known, np.stack([CENTRES[0], CENTRES[1] ** 2, np.ones_like(CENTRES[0])]), 9.0).astype(np.float32)
    extended, reached = extend(field, known)
    np.testing.assert_array_equal(reached, ndimage.binary_dilation(known, np.ones((3, 3, 3)), 2))
    np.testing.assert_array_equal(extended[:, known], field[:, known])
    assert not extended[:, ~reached].any()
    # Constants stay constants, and everything else stays within what it was.
    np.testing.assert_allclose(extended[2][reached], 1.0, atol=1e-6)
    assert extended[0][reached].min() >= field[0][known].min() - 1e-6
    assert extended[0][reached].max() <= field[0][known].max() + 1e-6


def test_carrying_on_halves_the_step_at_the_surface() -> None:
    """Against zeros outside, the jump between a surface node and its outer neighbour all but vanishes."""
    known = ball(0.25)
    field = np.where(known, 1.0 + CENTRES[0] - CENTRES[2], 0.0).astype(np.float32)
    extended, _ = extend(np.stack([field] * 3), known)
    edge = known[:-1] & ~known[1:]
    assert np.abs(np.diff(field, axis=0))[edge].min() > 0.5
    assert np.abs(np.diff(extended[0], axis=0))[edge].max() < 0.1


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_extending_treats_all_sides_alike(axis: int) -> None:
    rng = np.random.default_rng(1)
    known = rng.random((32, 32, 32)) < 0.01
    field = rng.random((3, 32, 32, 32)).astype(np.float32)
    mirrored = extend(np.flip(field, 1 + axis).copy(), np.flip(known, axis).copy())[0]
    np.testing.assert_allclose(mirrored, np.flip(extend(field, known)[0], 1 + axis), atol=1e-6)


def test_packed_fields_come_back_where_they_were() -> None:
    nodes = ball(0.2)
    fields = [np.where(nodes, CENTRES + i, 0.0).astype(np.float32) for i in range(2)]
    values = pack_fields(fields, unpack_nodes(pack_nodes(nodes)))
    assert values.shape == (2, 3, nodes.sum())
    np.testing.assert_allclose(unpack_fields(values, nodes), np.stack(fields), atol=2e-3)
