import numpy as np
import pytest

from service.core.prior_octants import HELD_ABOVE, octants


@pytest.mark.parametrize("low", [6, 7, 8])  # voxels are read by eight: the second layer is of the same eight or not
def test_octants_and_quadrants_hold_what_the_voxels_have_in_them(low: int) -> None:
    """Every voxel's part in a half of a cell is how much of the one overlaps the other, along each axis."""
    rest = np.zeros((64, 64, 64), bool)
    rest[3:20, 5:16, low : low + 33] = np.random.default_rng(0).random((17, 11, 33)) < 0.4
    cells = (3, 2, 5)
    held, sole = octants(rest, (3, 5, low), (20, 16, low + 33), cells)
    overlaps = []  # (halves, voxels) an axis
    for count, size in zip(cells, (17, 11, 33), strict=True):
        face = np.clip(np.arange(size + 1) * 2 * count / size - np.arange(2 * count)[:, None], 0.0, 1.0)
        overlaps.append(np.diff(face) / 2)
    box = rest[3:20, 5:16, low : low + 33].astype(float)
    expected = np.einsum("xi,yj,zk,ijk->xyz", *overlaps, box).reshape(3, 2, 2, 2, 5, 2)
    expected = expected.transpose(1, 3, 5, 0, 2, 4).reshape(8, 3, 2, 5)
    np.testing.assert_allclose(held, expected, atol=1e-6)
    floor = np.where(box[:, :, 0] > 0, 1.0, HELD_ABOVE * box[:, :, 1])
    expected = np.einsum("xi,yj,ij->xy", *overlaps[:2], floor).reshape(3, 2, 2, 2)
    np.testing.assert_allclose(sole, expected.transpose(1, 3, 0, 2).reshape(4, 3, 2), atol=1e-6)


def test_a_body_one_voxel_high_at_the_top_of_the_grid_stands_on_itself() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[10:20, 10:20, 63] = True
    _, sole = octants(rest, (10, 10, 63), (20, 20, 64), (1, 1, 1))
    assert sole.sum() == pytest.approx(1.0)
