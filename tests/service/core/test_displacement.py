import numpy as np
import pytest

from service.core.displacement import at_voxels, body_box, corrected, look_up

STEPS = (np.arange(32) + 0.5) / 32
CENTRES = np.stack(np.meshgrid(STEPS, STEPS, STEPS, indexing="ij")).astype(np.float32)


def lattice(size: int) -> np.ndarray:
    steps = (np.arange(size) + 0.5) / size
    return np.stack(np.meshgrid(steps, steps, steps, indexing="ij")).astype(np.float32)


def constant(*vector: float) -> np.ndarray:
    return np.broadcast_to(np.array(vector, np.float32)[:, None, None, None], (3, 32, 32, 32)).copy()


@pytest.mark.parametrize("size", [16, 32])
def test_a_linear_field_is_looked_up_exactly_inside_the_lattice(size: int) -> None:
    slopes = np.array([[1.0, 0.2, 0.0], [0.0, -0.5, 0.3], [0.4, 0.0, 0.7]], np.float32)
    field = np.einsum("ca,axyz->cxyz", slopes, lattice(size)).astype(np.float32)
    points = (0.05 + 0.9 * np.random.default_rng(0).random((3, 32, 32, 32))).astype(np.float32)
    np.testing.assert_allclose(look_up(field, points), np.einsum("ca,axyz->cxyz", slopes, points), atol=1e-3)


def test_outside_the_lattice_the_last_value_holds() -> None:
    field = lattice(16)
    far = np.full((3, 32, 32, 32), 3.0, np.float32)
    np.testing.assert_allclose(look_up(field, far), 1.0 - 0.5 / 16, atol=1e-6)


def test_no_correction_leaves_the_field() -> None:
    field = (0.01 * np.sin(4 * CENTRES)).astype(np.float32)
    np.testing.assert_allclose(corrected(field, np.zeros((3, 16, 16, 16), np.float32)), field, atol=2e-4)


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
    assert body_box(rest) == ((20 / 64, 30 / 64, 0.0), (36 / 64, 40 / 64, 24 / 64))
    field = np.zeros((3, 32, 32, 32), np.float32)
    field[0] = 0.1 * CENTRES[2]
    correction = np.full((3, 16, 16, 16), 0.02, np.float32)
    part, whole = corrected(field, correction, body_box(rest)), corrected(field, correction)
    # Within reach: x from 20/64 to 36/64 + 0.12, and no farther than two nodes beyond.
    np.testing.assert_array_equal(part[:, 10:22, 15:21, :13], whole[:, 10:22, 15:21, :13])
    np.testing.assert_array_equal(part[:, :7], field[:, :7])
    np.testing.assert_array_equal(part[:, 27:], field[:, 27:])


def test_nothing_moves_farther_than_it_is_high() -> None:
    field = corrected(constant(0.3, 0.0, 0.0), np.full((3, 16, 16, 16), 0.1, np.float32))
    assert bool((np.linalg.norm(field, axis=0) <= CENTRES[2] + 1e-6).all())
    np.testing.assert_allclose(field[:, :, :, 20:], constant(0.4, 0.1, 0.1)[:, :, :, 20:], atol=1e-5)


def test_voxels_lie_between_nodes_and_the_sole_does_not_move() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[10:20, 10:20, :5] = True
    fine = at_voxels((0.1 * CENTRES).astype(np.float32), rest)
    steps = ((np.arange(64) + 0.5) / 64).astype(np.float32)
    np.testing.assert_allclose(fine[2, 30, 30, 1:-1], 0.1 * steps[1:-1], atol=1e-6)
    np.testing.assert_allclose(fine[0, 1:-1, 30, 30], 0.1 * steps[1:-1], atol=1e-6)
    np.testing.assert_allclose(fine[1, 30, 1:-1, 30], 0.1 * steps[1:-1], atol=1e-6)
    assert not fine[:, 10:20, 10:20, 0].any()
    assert fine[0, 9, 10, 0] > 0
