import numpy as np
import pytest

from service.core.prior_moments import GAUSS_3, HELD_ABOVE, quadrature_weights


@pytest.mark.parametrize("low", [6, 7, 8])  # voxels are read by eight: the second layer is of the same eight or not
def test_weights_integrate_squares_over_the_material_of_every_cell_and_over_its_sole(low: int) -> None:
    """Every voxel's part in a cell holds ∫ xᵃ yᵇ zᶜ = Π (highᵏ⁺¹ − lowᵏ⁺¹)/(k + 1), in edges of the cell."""
    rest = np.zeros((64, 64, 64), bool)
    rest[3:20, 5:16, low : low + 33] = np.random.default_rng(0).random((17, 11, 33)) < 0.4
    cells = (3, 2, 5)
    weights, floor = quadrature_weights(rest, (3, 5, low), (20, 16, low + 33), cells)
    powers = [(0, 0, 0), (1, 0, 0), (0, 2, 1), (2, 2, 2)]
    integrals = []  # (power, cells, voxels) an axis
    for count, size in zip(cells, (17, 11, 33), strict=True):
        face = np.clip(np.arange(size + 1) * count / size - np.arange(count)[:, None], 0.0, 1.0)
        integrals.append([np.diff(face ** (k + 1)) / (k + 1) for k in range(3)])
    box = rest[3:20, 5:16, low : low + 33].astype(float)
    sole = np.where(box[:, :, 0] > 0, 1.0, HELD_ABOVE * box[:, :, 1])
    points = np.stack(np.meshgrid(GAUSS_3, GAUSS_3, GAUSS_3, indexing="ij")).reshape(3, 27)
    for a, b, c in powers:
        expected = np.einsum("xi,yj,zk,ijk->xyz", integrals[0][a], integrals[1][b], integrals[2][c], box)
        found = np.einsum("q,qxyz->xyz", points[0] ** a * points[1] ** b * points[2] ** c, weights)
        np.testing.assert_allclose(found, expected, atol=1e-5)
        expected = np.einsum("xi,yj,ij->xy", integrals[0][a], integrals[1][b], sole)
        found = np.einsum("q,qxy->xy", points[0, ::3] ** a * points[1, ::3] ** b, floor)
        np.testing.assert_allclose(found, expected, atol=1e-5)


def test_a_body_one_voxel_high_at_the_top_of_the_grid_stands_on_itself() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[10:20, 10:20, 63] = True
    _, floor = quadrature_weights(rest, (10, 10, 63), (20, 20, 64), (1, 1, 1))
    assert floor.sum() == pytest.approx(1.0)
