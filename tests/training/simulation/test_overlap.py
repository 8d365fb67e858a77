import numpy as np
import pytest

from tests.training.simulation.bodies import box, bridge, sphere
from training.metrics import iou
from training.simulation.body import Body
from training.simulation.loads import Load
from training.simulation.overlap import RestOverlap
from training.simulation.rasterise import Rasteriser
from training.simulation.solver import LinearSolver


@pytest.fixture(scope="module")
def block():
    body = Body.from_distance(box([0.45, 0.5, 0.26], [0.2, 0.17, 0.26]), 24)
    return body, RestOverlap.of(body)


def test_a_body_at_rest_fills_its_place(block):
    body, overlap = block
    assert overlap.along(np.ones((body.nodes, 3))).iou(0.0) > 0.995


@pytest.mark.parametrize("shift", [0.004, 0.03, 0.1])
def test_a_shifted_block_overlaps_by_what_is_left(block, shift):
    """A block of width w moved by d: IoU = (w − d)/(w + d), below a voxel of 1/64 too."""
    body, overlap = block
    along = overlap.along(np.tile([1.0, 0.0, 0.0], (body.nodes, 1)))
    assert along.iou(shift) == pytest.approx((0.4 - shift) / (0.4 + shift), abs=0.006)


def test_a_swollen_block_counts_by_its_volume(block):
    """Stretched along z by 1 + s from its foot: IoU = 1/(1 + s)."""
    body, overlap = block
    stretch = np.zeros((body.nodes, 3))
    stretch[:, 2] = body.node_positions[:, 2]
    assert overlap.along(stretch).iou(0.5) == pytest.approx(1.0 / 1.5, abs=0.012)


def test_what_leaves_the_cube_does_not_count(block):
    body, overlap = block
    assert overlap.along(np.tile([1.0, 0.0, 0.0], (body.nodes, 1))).iou(1.0) == 0.0


@pytest.mark.parametrize(
    "distance, contact", [(bridge(), [0.5, 0.5, 8 / 12]), (sphere([0.5, 0.5, 0.28], 0.3), [0.5, 0.5, 0.58])]
)
def test_a_look_sees_what_voxels_see(distance, contact):
    body = Body.from_distance(distance, 12)
    linear = LinearSolver(body, 0.3).solve([Load(np.array(contact), np.array([0.8, 0.0, -0.6]), 1e-3, 0.2)])[0]
    along, fine = RestOverlap.of(body).along(linear), Rasteriser(body)
    for factor in np.array([0.03, 0.1, 0.25]) / np.abs(linear).max():
        assert along.iou(factor) == pytest.approx(iou(fine.rest, fine.occupancy(factor * linear)), abs=0.03)


def test_a_few_points_see_nearly_what_all_see(block):
    body, overlap = block
    along = overlap.along(np.tile([1.0, 0.0, 0.0], (body.nodes, 1)))
    assert along.iou(0.05, every=4) == pytest.approx(along.iou(0.05), abs=0.02)
