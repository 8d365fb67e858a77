import numpy as np
import pytest

from service.core.displacement import corrected
from service.core.extent import filled_range
from service.core.lookup import Warp

STEPS = (np.arange(32) + 0.5) / 32
CENTRES = np.stack(np.meshgrid(STEPS, STEPS, STEPS, indexing="ij")).astype(np.float32)


def lattice(size: int) -> np.ndarray:
    steps = (np.arange(size) + 0.5) / size
    return np.stack(np.meshgrid(steps, steps, steps, indexing="ij")).astype(np.float32)


def constant(*vector: float) -> np.ndarray:
    return np.broadcast_to(np.array(vector, np.float32)[:, None, None, None], (3, 32, 32, 32)).copy()


def looked_up(lattice: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Trilinear between nodes at (i + ½)/s, the last value outside: a sum over the eight nodes around each place."""
    size = lattice.shape[1]
    place = np.clip(points.astype(np.float64) * size - 0.5, 0.0, size - 1.0)
    below = np.minimum(place.astype(int), size - 2)
    share = place - below
    result = np.zeros(points.shape)
    for node in np.ndindex(2, 2, 2):
        weight = np.prod([share[axis] if node[axis] else 1.0 - share[axis] for axis in range(3)], axis=0)
        result += weight * lattice[:, below[0] + node[0], below[1] + node[1], below[2] + node[2]]
    return result


@pytest.mark.parametrize("size", [16, 32])
def test_the_kernel_is_the_formula(size: int) -> None:
    """u(y) = δ(ψ(y)) + u_b(y − δ), δ no longer than ψ(y) is high; some places lie outside of both lattices."""
    rng = np.random.default_rng(3)
    backward = rng.normal(0.0, 0.1, (3, 32, 32, 32)).astype(np.float32)
    correction = rng.normal(0.0, 0.1, (3, size, size, size)).astype(np.float32)
    rest = CENTRES - backward
    moved = looked_up(correction, rest)
    moved *= np.minimum(1.0, np.maximum(rest[2], 0.0) / np.linalg.norm(moved, axis=0))
    expected = moved + looked_up(backward, CENTRES - moved)
    np.testing.assert_allclose(corrected(backward, correction), expected, atol=3e-5)


def test_what_is_no_number_stays_where_it_is() -> None:
    """A lookup at such a place must not leave the lattice."""
    field = constant(0.0, 0.0, 0.0)
    field[:, 3, 4, 5] = np.nan, np.inf, -np.inf
    found = corrected(field, np.full((3, 16, 16, 16), 0.01, np.float32))
    assert np.isfinite(found[:, 10:, 10:, 10:]).all()


def test_no_correction_leaves_the_field() -> None:
    field = (0.01 * np.sin(4 * CENTRES)).astype(np.float32)
    np.testing.assert_allclose(corrected(field, np.zeros((3, 16, 16, 16), np.float32)), field, atol=1e-7)


def test_without_a_field_the_correction_is_all() -> None:
    correction = (0.01 * lattice(16)).astype(np.float32)
    inner = (slice(None), *(slice(1, -1),) * 3)
    np.testing.assert_allclose(corrected(constant(0, 0, 0), correction)[inner], (0.01 * CENTRES)[inner], atol=1e-4)


def test_material_that_was_turned_and_is_then_pushed_comes_from_where_it_was() -> None:
    """φ(x) = R x about an axis, then + δ: at y the material is that of Rᵀ(y − δ), so u(y) = y − Rᵀ(y − δ)."""
    angle = 0.3
    turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]], np.float32)
    middle = np.array([0.5, 0.5, 0.0], np.float32)[:, None, None, None]
    field = CENTRES - middle - np.einsum("ji,jxyz->ixyz", turn, CENTRES - middle)
    push = np.array([0.03, -0.02, 0.04], np.float32)[:, None, None, None]
    correction = np.broadcast_to(push, (3, 16, 16, 16)).astype(np.float32)
    expected = CENTRES - middle - np.einsum("ji,jxyz->ixyz", turn, CENTRES - middle - push)
    inner = (slice(None), slice(4, 28), slice(4, 28), slice(16, 28))
    np.testing.assert_allclose(corrected(field.astype(np.float32), correction)[inner], expected[inner], atol=1e-3)


def test_only_where_the_body_can_get_to_is_corrected() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[20:36, 30:40, :24] = True
    body = Warp(rest).body
    assert body == ((20 / 64, 30 / 64, 0.0), (36 / 64, 40 / 64, 24 / 64))
    field = np.zeros((3, 32, 32, 32), np.float32)
    field[0] = 0.1 * CENTRES[2]
    correction = np.full((3, 16, 16, 16), 0.02, np.float32)
    assert filled_range(rest) == ((20, 30, 0), (36, 40, 24))
    part, whole = corrected(field, correction, body), corrected(field, correction)
    # Within reach: x from 20/64 to 36/64 + 0.12, and no farther than three nodes beyond.
    np.testing.assert_array_equal(part[:, 10:22, 15:21, :13], whole[:, 10:22, 15:21, :13])
    np.testing.assert_array_equal(part[:, :6], field[:, :6])
    np.testing.assert_array_equal(part[:, 26:], field[:, 26:])


def test_a_correction_far_from_the_body_reaches_no_farther() -> None:
    """The network says what it likes there; what it says of the body decides how much of the field it puts right."""
    field = np.zeros((3, 32, 32, 32), np.float32)
    correction = np.full((3, 16, 16, 16), 0.01, np.float32)
    correction[:, 14:] = 0.5
    found = corrected(field, correction, ((0.25, 0.25, 0.0), (0.5, 0.5, 0.5)))
    np.testing.assert_allclose(found[:, 6:18, 6:18, 1:18], 0.01, atol=1e-6)
    assert not found[:, 21:].any()


def test_nothing_is_corrected_by_more_than_its_height_at_rest() -> None:
    field = corrected(constant(0.0, 0.0, 0.0), np.full((3, 16, 16, 16), 0.1, np.float32))
    assert bool((np.linalg.norm(field, axis=0) <= CENTRES[2] + 1e-6).all())
    np.testing.assert_allclose(field[:, :, :, 20:], 0.1, atol=1e-5)


def test_what_droops_to_the_floor_is_left_where_nothing_corrects_it() -> None:
    """It comes from above, and has moved farther than the place is high."""
    field = constant(0.3, 0.0, -0.4)
    np.testing.assert_array_equal(corrected(field, np.zeros((3, 16, 16, 16), np.float32)), field)


def test_the_box_is_that_of_every_voxel() -> None:
    rest = np.zeros((64, 64, 64), bool)
    assert filled_range(rest) is None and Warp(rest).body is None
    rest[63, 5, 0] = rest[7, 60, 9] = rest[20, 3, 62] = True
    assert filled_range(rest) == ((7, 3, 0), (64, 61, 63))
