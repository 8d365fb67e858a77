import numpy as np
import pytest

from service.core.grids import pack_bits
from tests.training import tiny
from training.baselines import LinearFem, NearestNeighbours, NeoHookeanFem, distance_of, identity, mean_shape


def bits(*grids: np.ndarray) -> np.ndarray:
    return np.stack([pack_bits(grid) for grid in grids])


def test_identity_is_the_body_at_rest() -> None:
    np.testing.assert_array_equal(identity(bits(tiny.box(0), tiny.box(2)))[1], tiny.box(2))


def test_the_mean_shape_is_the_share_of_answers_that_fill_a_voxel() -> None:
    mean = mean_shape(bits(tiny.box(0), tiny.box(0), tiny.box(0), tiny.box(3)))
    only_large = tiny.box(3) & ~tiny.box(0)
    assert np.unique(mean[only_large]).tolist() == [0.25]
    assert np.unique(mean[tiny.box(0)]).tolist() == [1.0]


def neighbours(count: int) -> NearestNeighbours:
    answers = bits(tiny.box(0), tiny.box(1), tiny.box(5))
    return NearestNeighbours(np.array([[0.0, 0.0], [1.0, 0.0], [9.0, 0.0]]), answers, np.ones(2), count)


def test_neighbours_weigh_by_inverse_distance() -> None:
    """At (0.25, 0): 1/0.25 against 1/0.75, that is three quarters and one."""
    row, weight = neighbours(2).weights(np.array([[0.25, 0.0]]))
    assert row.tolist() == [[0, 1]]
    np.testing.assert_allclose(weight, [[0.75, 0.25]])
    between = neighbours(2)(np.array([[0.25, 0.0]]))[0]
    assert np.unique(between[tiny.box(1) & ~tiny.box(0)]).tolist() == [0.25]


def test_where_less_is_known_all_of_it_counts() -> None:
    place = np.array([[0.25, 0.0]])
    np.testing.assert_array_equal(neighbours(9)(place), neighbours(3)(place))


def test_a_known_condition_gives_its_own_answer() -> None:
    for count in (1, 2):
        answer = neighbours(count)(np.array([[1.0, 0.0]]))[0]
        np.testing.assert_allclose(answer, tiny.box(1), atol=1e-6)


def test_the_scale_says_which_field_matters() -> None:
    answers = bits(tiny.box(0), tiny.box(1))
    known = np.array([[0.0, 0.0], [1.0, 1.0]])
    for scale, nearest in (((10.0, 1.0), 0), ((1.0, 10.0), 1)):
        row, _ = NearestNeighbours(known, answers, np.array(scale), 1).weights(np.array([[0.2, 0.8]]))
        assert row.tolist() == [[nearest]]


def test_the_distance_of_a_grid_is_that_of_its_block() -> None:
    """The block's faces lie between voxels; half-way up, its side at x = 0.7 is the nearest of them."""
    rest = tiny.box(0)
    filled = np.flatnonzero(rest.any(axis=(1, 2)))
    side = (filled[-1] + 1) / 64
    points = np.array([[side + d, 0.5, 0.1] for d in (-0.05, 0.0, 0.05)], np.float32)
    np.testing.assert_allclose(distance_of(rest)(points), [-0.05, 0.0, 0.05], atol=1e-6)
    # It stands on the floor and goes on below it: the floor is no surface.
    assert distance_of(rest)(np.array([[0.5, 0.5, 0.0]], np.float32))[0] < -0.05
    with pytest.raises(ValueError, match="surface of nothing"):
        distance_of(np.zeros_like(rest))


def test_linear_fem_bends_a_column_as_a_beam() -> None:
    """Tip of a clamped column under a side push at its top: F h³/3EI + F h/κGA (Timoshenko), ν = 0.3.

    0.25 wide, 0.75 high; the patch spreads the load a little below the top, and eight cells are two in thickness.
    """
    rest = np.zeros((64, 64, 64), bool)
    rest[24:40, 24:40, :48] = True
    load, width, height = 2e-4, 0.25, 0.75
    condition = np.array([0.5, 0.5, 0.75, 1.0, 0.0, 0.0, np.log10(load), 0.3, 0.08], np.float32)
    result = LinearFem(rest, 16)(condition)
    tip = float(result.forward[0, 25:39, 25:39, 47].mean())
    shear_modulus = 1 / (2 * 1.3)
    beam = load * height**3 / (3 * width**4 / 12) + load * height / (5 / 6 * shear_modulus * width**2)
    assert tip == pytest.approx(beam, rel=0.1)
    assert result.deformed.sum() == pytest.approx(rest.sum(), rel=0.02)


def test_neo_hookean_fem_is_the_linear_one_for_small_loads_and_keeps_its_length_for_large_ones() -> None:
    """A linear column grows as it bends: its tip moves along a straight line, not an arc."""
    rest = np.zeros((64, 64, 64), bool)
    rest[28:36, 16:48, :32] = True  # a wall, one cell thick at 8³
    small = np.array([0.5, 0.5, 0.5, 1.0, 0.0, 0.0, -6.0, 0.3, 0.1], np.float32)
    linear, nonlinear = LinearFem(rest, 8), NeoHookeanFem(rest, 8)
    assert nonlinear(small).peak_displacement == pytest.approx(linear(small).peak_displacement, rel=1e-3)
    large = small.copy()
    large[6] += np.log10(0.25 / linear(small).peak_displacement)
    assert linear(large).forward[2, 30, 20:44, 31].min() > nonlinear(large).forward[2, 30, 20:44, 31].min()
    assert np.isfinite(nonlinear(large).peak_displacement)
    top = nonlinear(large).forward[:, 32, 20:44, 30].mean(axis=1)
    assert top[0] > 0.05
    assert top[2] < -0.01
