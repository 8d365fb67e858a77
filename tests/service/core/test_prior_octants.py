import numpy as np
import pytest

from service.core.prior_octants import octants


@pytest.mark.parametrize("low", [6, 7, 8])  # voxels are read by eight
def test_octants_hold_what_the_voxels_have_in_them(low: int) -> None:
    """Every voxel's part in a half of a cell is how much of the one overlaps the other, along each axis."""
    rest = np.zeros((64, 64, 64), bool)
    rest[3:20, 5:16, low : low + 33] = np.random.default_rng(0).random((17, 11, 33)) < 0.4
    cells = (3, 2, 5)
    held = octants(rest, (3, 5, low), (20, 16, low + 33), cells)
    overlaps = []  # (halves, voxels) an axis
    for count, size in zip(cells, (17, 11, 33), strict=True):
        face = np.clip(np.arange(size + 1) * 2 * count / size - np.arange(2 * count)[:, None], 0.0, 1.0)
        overlaps.append(np.diff(face) / 2)
    box = rest[3:20, 5:16, low : low + 33].astype(float)
    expected = np.einsum("xi,yj,zk,ijk->xyz", *overlaps, box).reshape(3, 2, 2, 2, 5, 2)
    expected = expected.transpose(1, 3, 5, 0, 2, 4).reshape(8, 3, 2, 5)
    np.testing.assert_allclose(held, expected, atol=1e-6)
