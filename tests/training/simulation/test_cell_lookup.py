import numpy as np

from training.simulation.cell_lookup import locate, settle

CELLS = np.full((4, 4, 4), -1)
CELLS[1:3, 1:3, 0:2] = np.arange(8).reshape(2, 2, 2)


def test_points_lie_in_their_cell_at_its_local_coordinates():
    cell, local = locate(np.array([[0.3, 0.6, 0.49], [0.1, 0.3, 0.1], [0.3, 0.3, 1.2]]), CELLS)
    np.testing.assert_array_equal(cell, [CELLS[1, 2, 1], -1, -1])
    np.testing.assert_allclose(local[0], [0.2, 0.4, 0.96])


def test_a_point_on_a_face_settles_in_the_cell_that_holds_material():
    """The face at x = 0.75 borders an empty cell on the side its normal points to."""
    point, normal = np.array([[0.75, 0.3, 0.1]]), np.array([[1.0, 0.0, 0.0]])
    assert locate(point, CELLS)[0][0] == -1
    cell, local = settle(point, normal, CELLS)
    assert cell[0] == CELLS[2, 1, 0]
    np.testing.assert_allclose(local[0], [1.0, 0.2, 0.4], atol=2e-4)


def test_a_point_above_a_face_settles_deeper_but_not_farther_than_a_third_of_a_cell():
    normal = np.array([[0.0, 0.0, 1.0]])
    assert settle(np.array([[0.3, 0.3, 0.56]]), normal, CELLS)[0][0] == CELLS[1, 1, 1]
    assert settle(np.array([[0.3, 0.3, 0.60]]), normal, CELLS)[0][0] == -1
