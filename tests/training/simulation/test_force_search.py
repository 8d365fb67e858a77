import numpy as np
import pytest

from tests.training.simulation.bodies import bridge, column
from training.metrics import iou
from training.simulation.body import Body
from training.simulation.force_search import force_for_identity_iou, force_for_peak
from training.simulation.loads import Load
from training.simulation.overlap import RestOverlap
from training.simulation.rasterise import Rasteriser
from training.simulation.solver import LinearSolver


@pytest.mark.parametrize("target", [0.35, 0.6, 0.85])
def test_the_linear_response_overlaps_as_wanted(target):
    body = Body.from_distance(bridge(), 12)
    solver = LinearSolver(body, 0.3)
    load = Load(np.array([0.5, 0.5, 8 / 12]), np.array([0.8, 0.0, -0.6]), 1e-3)
    linear = solver.solve([load])[0]
    found = force_for_identity_iou(RestOverlap.of(body), load, linear, target)
    assert found is not None
    fine = Rasteriser(body)
    deformed = fine.occupancy(linear * found.load_number / load.load_number)
    assert iou(fine.rest, deformed) == pytest.approx(target, abs=0.03)
    np.testing.assert_array_equal(found.contact, load.contact)


def test_no_force_is_given_where_none_within_the_cube_reaches_the_target():
    """Pressing a stout block at the top moves its upper part only."""
    body = Body.from_distance(column(0.7, 0.3), 12)
    solver = LinearSolver(body, 0.3)
    load = Load(np.array([0.5, 0.5, 0.3]), np.array([0.0, 0.0, 1.0]), 1e-3)
    assert force_for_identity_iou(RestOverlap.of(body), load, solver.solve([load])[0], 0.05) is None


def test_the_linear_response_peaks_where_wanted():
    body = Body.from_distance(column(0.3, 0.6), 12)
    load = Load(np.array([0.5, 0.5, 0.6]), np.array([0.8, 0.0, -0.6]), 1e-3)
    solver = LinearSolver(body, 0.3)
    found = force_for_peak(body, load, solver.solve([load])[0], 0.02)
    assert found is not None
    moved = solver.solve([found])[0][body.solid_nodes]
    assert np.linalg.norm(moved, axis=1).max() == pytest.approx(0.02)
    assert force_for_peak(body, load, np.zeros_like(body.node_positions), 0.02) is None


def test_identity_iou_of_nothing_is_one():
    empty = np.zeros((4, 4, 4), bool)
    assert iou(empty, empty) == 1.0
    assert iou(~empty, empty) == 0.0
