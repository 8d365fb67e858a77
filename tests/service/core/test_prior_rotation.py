import numpy as np

from service.core.prior_rotation import cofactors, exponential, inverse_cube_root, polar_rotations, turn, turn_back


def rotations(count: int) -> np.ndarray:
    axes = np.random.default_rng(0).uniform(-1.7, 1.7, (count, 3)).astype(np.float32)
    return np.stack([np.reshape(exponential(*axis), (3, 3)) for axis in axes], axis=-1).astype(np.float32)


def test_the_exponential_of_a_quarter_turn_about_z_takes_x_to_y() -> None:
    quarter = np.reshape(exponential(np.float32(0.0), np.float32(0.0), np.float32(np.pi / 2)), (3, 3))
    np.testing.assert_allclose(quarter, [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]], atol=1e-6)


def test_exponentials_are_rotations_about_their_axis() -> None:
    some = rotations(50).transpose(2, 0, 1)
    np.testing.assert_allclose(some @ some.transpose(0, 2, 1), np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-5)
    np.testing.assert_allclose(np.linalg.det(some), 1.0, atol=1e-5)
    axis = np.array([0.3, -0.2, 0.9], np.float32)
    np.testing.assert_allclose(np.reshape(exponential(*axis), (3, 3)) @ axis, axis, atol=1e-6)


def test_the_polar_rotation_of_a_stretched_rotation_is_the_rotation() -> None:
    rotation = rotations(50)
    noise = np.random.default_rng(0).normal(size=(50, 3, 3)) * 0.2
    stretch = np.eye(3) + 0.5 * (noise + noise.transpose(0, 2, 1))
    matrices = np.einsum("ijk,kjl->ilk", rotation, stretch).astype(np.float32)
    polar_rotations(matrices)
    np.testing.assert_allclose(matrices, rotation, atol=2e-3)


def test_an_inverted_cell_takes_the_rotation_of_its_skew_part() -> None:
    flat = np.diag([1.0, 1.0, -0.5]).astype(np.float32)[:, :, None].copy()
    polar_rotations(flat)
    np.testing.assert_allclose(flat[..., 0], np.eye(3), atol=1e-6)


def test_inverse_cube_roots_are_exact_to_rounding_over_all_magnitudes() -> None:
    values = np.geomspace(1e-3, 1e9, 200).astype(np.float32)
    roots = np.array([inverse_cube_root(value) for value in values])
    np.testing.assert_allclose(roots, values.astype(float) ** (-1.0 / 3.0), rtol=1e-6)


def test_cofactors_are_the_transposed_inverse_times_the_determinant() -> None:
    matrix = np.random.default_rng(1).normal(size=(3, 3))
    expected = np.linalg.inv(matrix).T * np.linalg.det(matrix)
    np.testing.assert_allclose(np.reshape(cofactors(*matrix.ravel().astype(np.float32)), (3, 3)), expected, atol=1e-5)


def test_vectors_are_turned_there_and_back() -> None:
    rotation = rotations(20)
    vectors = np.random.default_rng(2).normal(size=(3, 20)).astype(np.float32)
    turned, back = np.empty_like(vectors), np.empty_like(vectors)
    turn(rotation, vectors, turned)
    turn_back(rotation, turned, back)
    np.testing.assert_allclose(turned, np.einsum("ijk,jk->ik", rotation, vectors), atol=1e-6)
    np.testing.assert_allclose(back, vectors, atol=1e-5)
