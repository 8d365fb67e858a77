import numpy as np
import pytest

from service.core.prior_sole import GAUSS_3, HELD_ABOVE, sole_weights


def test_weights_integrate_squares_over_the_sole_of_every_cell() -> None:
    """Every voxel's part in a face holds ∫ xᵃ yᵇ = Π (highᵏ⁺¹ − lowᵏ⁺¹)/(k + 1), in edges of the face."""
    rest = np.zeros((64, 64, 64), bool)
    rest[3:20, 5:16, 7:40] = np.random.default_rng(0).random((17, 11, 33)) < 0.4
    weights = sole_weights(rest, (3, 5, 7), (20, 16, 40), (3, 2))
    integrals = []  # (power, cells, voxels) an axis
    for count, size in ((3, 17), (2, 11)):
        face = np.clip(np.arange(size + 1) * count / size - np.arange(count)[:, None], 0.0, 1.0)
        integrals.append([np.diff(face ** (k + 1)) / (k + 1) for k in range(3)])
    box = rest[3:20, 5:16, 7:40].astype(float)
    sole = np.where(box[:, :, 0] > 0, 1.0, HELD_ABOVE * box[:, :, 1])
    points = np.stack(np.meshgrid(GAUSS_3, GAUSS_3, indexing="ij")).reshape(2, 9)
    for a, b in ((0, 0), (1, 0), (0, 2), (2, 2)):
        expected = np.einsum("xi,yj,ij->xy", integrals[0][a], integrals[1][b], sole)
        found = np.einsum("q,qxy->xy", points[0] ** a * points[1] ** b, weights)
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_body_one_voxel_high_at_the_top_of_the_grid_stands_on_itself() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[10:20, 10:20, 63] = True
    assert sole_weights(rest, (10, 10, 63), (20, 20, 64), (1, 1)).sum() == pytest.approx(1.0)
