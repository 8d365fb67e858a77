import numpy as np

from service.core.grids import Grid, cross, invert_rigid, pack_bits, transform_points, unpack_bits
from tests.poses import pose


def test_first_voxel_is_the_least_significant_bit_of_the_first_byte() -> None:
    occupancy = np.zeros((64, 64, 64), bool)
    occupancy[0, 0, 0] = True
    assert pack_bits(occupancy)[0] == 1
    occupancy = np.zeros((64, 64, 64), bool)
    occupancy[0, 0, 9] = True  # z runs fastest: voxel 9 is bit 1 of byte 1
    assert pack_bits(occupancy)[:2].tolist() == [0, 2]


def test_bits_round_trip() -> None:
    occupancy = np.random.default_rng(0).random((64, 64, 64)) < 0.3
    packed = pack_bits(occupancy)
    assert packed.nbytes == 32768
    np.testing.assert_array_equal(unpack_bits(packed), occupancy)


def test_cross_product_is_numpys() -> None:
    a, b = np.random.default_rng(1).standard_normal((2, 3))
    np.testing.assert_array_equal(cross(a, b), np.cross(a, b))


def test_inverse_of_a_rigid_transform() -> None:
    transform = pose(rotation=(0.4, -1.1, 2.0), translation=(0.3, -2.0, 0.7))
    np.testing.assert_allclose(invert_rigid(transform) @ transform, np.eye(4), atol=1e-12)


def test_points_move_as_the_name_of_the_transform_reads() -> None:
    camera_from_grid = pose(rotation=(0.0, 0.0, np.pi / 2), translation=(1.0, 0.0, 0.0))
    moved = transform_points(camera_from_grid, np.array([[1.0, 0.0, 0.0]], np.float32))
    np.testing.assert_allclose(moved, [[1.0, 1.0, 0.0]], atol=1e-6)


def test_edge_is_64_voxels() -> None:
    assert Grid(pitch_m=0.002, camera_from_grid=np.eye(4)).edge_m == 0.128
