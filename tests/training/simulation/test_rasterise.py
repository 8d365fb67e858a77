import numpy as np
import pytest
from scipy import ndimage

from tests.training.simulation.bodies import box, bridge, sphere
from training.simulation.body import Body
from training.simulation.rasterise import Rasteriser, rasterise, voxel_centres


@pytest.fixture(scope="module")
def ball():
    body = Body.from_distance(sphere([0.5, 0.5, 0.28], 0.3), 24)
    return body, Rasteriser(body)


def iou(a, b):
    return (a & b).sum() / (a | b).sum()


def test_no_displacement_gives_the_body_at_rest(ball):
    body, rasteriser = ball
    result = rasteriser(np.zeros((body.nodes, 3)))
    assert iou(result.deformed, rasteriser.rest) > 0.9995
    assert np.nanmax(np.abs(result.backward)) < 1e-6
    assert result.peak_displacement == 0.0


def test_rest_occupancy_is_the_sign_of_the_distance_at_voxel_centres(ball):
    body, rasteriser = ball
    assert rasteriser.rest[32, 32, 18]
    assert not rasteriser.rest[2, 32, 18]
    np.testing.assert_array_equal(rasteriser.rest.ravel(), body.distance(voxel_centres()) < 0)


def test_affine_motion_is_exact():
    """y = A x + b has backward displacement y − A⁻¹(y − b) and occupancy sdf(A⁻¹(y − b)) < 0."""
    body = Body.from_distance(box([0.5, 0.5, 0.25], [0.2, 0.12, 0.25]), 24)
    angle = 0.6
    matrix = np.array([[np.cos(angle), 0.0, np.sin(angle)], [0.1, 1.1, 0.0], [-np.sin(angle), 0.0, np.cos(angle)]])
    shift = np.array([0.5, 0.5, 0.3]) - matrix @ [0.5, 0.5, 0.25]
    displacement = body.node_positions @ matrix.T + shift - body.node_positions
    result = rasterise(body, displacement)
    centres = voxel_centres().astype(np.float64)
    rest = (centres - shift) @ np.linalg.inv(matrix).T
    expected = (body.distance(rest.astype(np.float32)) < 0).reshape(64, 64, 64)
    assert iou(result.deformed, expected) > 0.999
    both = (result.deformed & expected).ravel()
    found = result.backward.reshape(3, -1)[:, both].T
    np.testing.assert_allclose(found, (centres - rest)[both], atol=1e-4)
    inside = ~np.isnan(result.forward[0]).ravel()
    np.testing.assert_allclose(
        result.forward.reshape(3, -1)[:, inside].T, (centres @ matrix.T + shift - centres)[inside], atol=1e-5
    )
    assert np.isnan(result.backward[0][~result.deformed]).all()


def test_curved_motion_agrees_with_its_exact_inverse():
    """A sheared and bent ball, y = x + (c z², 0, d x²): the deformed volume is exact to 0.35 %, without holes."""
    body = Body.from_distance(sphere([0.45, 0.5, 0.24], 0.25), 24)
    x, _, z = body.node_positions.T
    displacement = np.stack([0.8 * z**2, 0 * z, 0.5 * (x - 0.2) ** 2], axis=1)
    result = rasterise(body, displacement)
    # volume by the exact map: det = 1 − 1.6 z (x − 0.2), integrated over voxel centres of the body at rest
    centres = voxel_centres(128).astype(np.float64)
    centres = centres[body.distance(centres.astype(np.float32)) < 0]
    volume = (1 - 1.6 * centres[:, 2] * (centres[:, 0] - 0.2)).sum() / 128**3
    assert result.deformed.sum() / 64**3 == pytest.approx(volume, rel=0.0035)
    assert (ndimage.binary_fill_holes(result.deformed) == result.deformed).all()
    # following the backward field to rest and the exact map forward again comes back
    place = (np.argwhere(result.deformed) + 0.5) / 64
    rest = place - result.backward[:, result.deformed].T
    again = rest + np.stack([0.8 * rest[:, 2] ** 2, 0 * rest[:, 2], 0.5 * (rest[:, 0] - 0.2) ** 2], axis=1)
    # a trilinear cell of edge h follows a quadratic within (c + d) h²/8
    assert np.abs(again - place).max() < 1.3 / 24**2 / 8 + 1e-4


def test_peak_is_measured_inside_the_body_not_at_outer_nodes(ball):
    body, rasteriser = ball
    wild = np.zeros((body.nodes, 3))
    outside = body.distance(body.node_positions.astype(np.float32)) > 0.8 * body.cell_edge
    wild[outside] = 1.0
    steady = np.zeros((body.nodes, 3))
    steady[:] = [0.01, 0.0, 0.0]
    assert rasteriser(steady).peak_displacement == pytest.approx(0.01, rel=1e-5)
    assert outside.any()
    assert rasteriser(wild).peak_displacement < 0.5


def test_voxels_outside_the_grid_are_left_out():
    body = Body.from_distance(bridge(), 12)
    result = rasterise(body, np.tile([0.0, 0.0, 0.5], (body.nodes, 1)))
    expected = np.zeros((64, 64, 64), bool)
    expected[:, :, 32:] = Rasteriser(body).rest[:, :, :32]
    assert iou(result.deformed, expected) > 0.999


@pytest.mark.parametrize("cells", [2, 4, 8])
def test_a_trilinear_motion_is_inverted_however_coarse_its_cells(cells):
    """y = (x + 2.5 x z, y, z + 0.8 x y), det = 1 + 2.5 z − 2 x y: trilinear in cells, far from affine in large ones."""
    body = Body.from_distance(box([0.22, 0.22, 0.26], [0.18, 0.18, 0.26]), cells)

    def moved(place):
        x, y, z = place.T
        return np.stack([2.5 * x * z, 0.0 * y, 0.8 * x * y], axis=1)

    result = rasterise(body, moved(body.node_positions))
    places = (np.argwhere(result.deformed) + 0.5) / 64
    rest = places - result.backward[:, result.deformed].T
    np.testing.assert_allclose(rest + moved(rest), places, atol=4e-3 / cells)
    # the mean of det over the box is its value at the box's centre
    volume = 0.36 * 0.36 * 0.52 * (1.0 + 2.5 * 0.26 - 2.0 * 0.22**2)
    assert result.deformed.sum() / 64**3 == pytest.approx(volume, rel=0.01)


def test_every_deformed_voxel_is_listed_once():
    """Also those that two cells share, or of which one is not sure."""
    body = Body.from_distance(bridge(), 12)
    bent = 0.2 * body.node_positions[:, [2, 0, 1]] ** 2
    result = rasterise(body, bent)
    np.testing.assert_array_equal(np.sort(result.deformed_at), np.flatnonzero(result.deformed))
    assert len(result.moved_here) == len(result.deformed_at)
