import numpy as np
import pytest

from tests.training.simulation.bodies import box, column, sphere
from training.simulation.body import Body
from training.simulation.loads import Load, LoadError, nodal_forces


@pytest.fixture(scope="module")
def ball():
    return Body.from_distance(sphere([0.5, 0.5, 0.28], 0.3), 24)


def test_nodal_forces_sum_to_the_load(ball):
    direction = np.array([0.6, 0.0, -0.8])
    forces = nodal_forces(ball, Load(np.array([0.5, 0.5, 0.58]), direction, 0.37))
    np.testing.assert_allclose(forces.sum(axis=0), 0.37 * direction, atol=1e-15)


def test_traction_is_centred_on_the_contact(ball):
    """First moment Σ x w / Σ w is the contact, up to the curvature of the patch, 3R²/(8·2r) below the pole."""
    contact = np.array([0.5, 0.5, 0.58])
    weight = nodal_forces(ball, Load(contact, np.array([0.0, 0.0, 1.0]), 1.0))[:, 2]
    centre = weight @ ball.node_positions
    np.testing.assert_allclose(centre[:2], contact[:2], atol=1e-4)
    assert contact[2] - centre[2] == pytest.approx(0.25 * 0.1**2 / 0.6, abs=1e-3)


def test_traction_has_the_stated_profile():
    """Second moment of (1 − r²/R²)² over a disc: ⟨x²⟩ = R²/8, on a face that cuts through cells."""
    body = Body.from_distance(column(0.8, 0.51), 24)
    contact = np.array([0.5, 0.5, 0.51])
    weight = nodal_forces(body, Load(contact, np.array([0.0, 0.0, 1.0]), 1.0, 0.2))[:, 2]
    offset = body.node_positions - contact
    # trilinear spreading over a cell of edge h adds h²/6 to the second moment of a smooth density
    spread = body.cell_edge**2 / 6
    assert weight @ offset[:, 0] ** 2 == pytest.approx(0.2**2 / 8 + spread, rel=0.03)
    assert weight @ offset[:, 1] ** 2 == pytest.approx(0.2**2 / 8 + spread, rel=0.03)


def test_a_thin_wall_is_loaded_on_the_side_of_the_contact_only():
    body = Body.from_distance(box([0.5, 0.5, 0.3], [0.3, 0.0625, 0.3]), 24)
    weight = nodal_forces(body, Load(np.array([0.5, 0.5625, 0.4]), np.array([0.0, -1.0, 0.0]), 1.0, 0.2))[:, 1]
    assert weight[body.node_positions[:, 1] < 0.5].sum() == 0.0


def test_a_load_off_the_body_is_refused(ball):
    with pytest.raises(LoadError):
        nodal_forces(ball, Load(np.array([0.9, 0.9, 0.9]), np.array([0.0, 0.0, 1.0]), 1.0))
