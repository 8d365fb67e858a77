"""What a result says about places, against a shear that is known in closed form."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from service.client import NotInReply, Push, Result, Shape
from service.client.displacement import REACH_VOXELS, nearest_places
from service.client.question import question
from tests.service.client.answers import BODY, GRID, PITCH_M, answer, in_camera, sheared

RESULT = answer(loads=2)
INSIDE_M = (np.argwhere(BODY)[::97] + 0.5) * PITCH_M


def axes_in_camera(vectors_grid: np.ndarray) -> np.ndarray:
    return vectors_grid @ GRID.camera_from_grid[:3, :3].T


def test_points_stand_where_the_voxels_are():
    points = RESULT.points_camera("reconstruction")
    np.testing.assert_allclose(points, in_camera((np.argwhere(BODY) + 0.5) * PITCH_M), atol=1e-6)
    assert len(RESULT.points_camera()) == RESULT.deformed.sum()
    np.testing.assert_array_equal(RESULT.points_camera(push=1), RESULT[1].points_camera())


def test_the_displacement_of_points_of_the_rest_body():
    """A material point X moves by u(X), although the field is given at the places where it ends up."""
    moved = RESULT.displacement_at(in_camera(INSIDE_M))
    error_m = np.linalg.norm(moved - axes_in_camera(sheared(INSIDE_M)), axis=1)
    # Half precision is good to 0.01 mm here; at the skin the voxels within stand in for those without.
    assert np.median(error_m) < 2e-5
    assert error_m.max() < 0.25 * PITCH_M


def test_the_displacement_of_places_of_the_deformed_body():
    places = INSIDE_M + sheared(INSIDE_M)
    moved = RESULT.displacement_at(in_camera(places), "deformed")
    error_m = np.linalg.norm(moved - axes_in_camera(sheared(INSIDE_M)), axis=1)
    assert np.median(error_m) < 2e-5
    assert error_m.max() < 0.25 * PITCH_M


def test_there_is_no_displacement_where_there_is_no_body():
    far_m = in_camera(np.array([[0.10, 0.13, 0.20], [0.10, 0.13, 0.05]]))
    moved = RESULT.displacement_at(far_m)
    assert np.isnan(moved[0]).all()
    assert np.isfinite(moved[1]).all()
    assert RESULT.displacement_at(np.empty((0, 3))).shape == (0, 3)
    # A single point is one of n.
    assert RESULT.displacement_at(far_m[1]).shape == (1, 3)
    # Pixels without a reading are no places, and spoil no others.
    with_holes = np.array([[np.nan] * 3, far_m[1], [np.inf, 0.0, 0.0]])
    np.testing.assert_array_equal(np.isnan(RESULT.displacement_at(with_holes)).all(axis=1), [True, False, True])
    np.testing.assert_array_equal(RESULT.displacement_at(with_holes)[1], moved[1])


@pytest.mark.parametrize("seed", [0, 1])
def test_the_search_for_the_nearest_voxel_leaves_none_out(seed):
    rng = np.random.default_rng(seed)
    places, points = (rng.uniform(0.0, 40.0, (count, 3)).astype(np.float32) for count in (900, 700))
    index, distance = nearest_places(points, places)
    every = np.linalg.norm(points[:, None] - places, axis=2)
    near = every.min(axis=1) <= REACH_VOXELS
    assert 0.2 < near.mean() < 0.8
    np.testing.assert_array_equal(index[near], every.argmin(axis=1)[near])
    np.testing.assert_allclose(distance[near], every.min(axis=1)[near], rtol=1e-5)
    assert (distance[~near] > REACH_VOXELS).all()


def test_answers_and_questions_say_themselves_in_a_line():
    """A notebook prints what a cell ends with: no grid, no image."""
    flagged = replace(RESULT, flags=frozenset({"up_unknown"}))
    assert re.fullmatch(
        r"<Result of \S+ \S+: moves by [\d.]+ mm at most.*; moves by [\d.]+ mm at most.* \[up_unknown\]>", repr(flagged)
    )
    assert repr(RESULT[0]).startswith("<PushResult: moves by ")
    assert re.fullmatch(r"<Mesh: \d+ vertices, \d+ faces>", repr(RESULT.mesh()))
    asked = question(np.ones((480, 640), np.uint16), None, Push((0, 0, 1), contact_m=(0, 0, 1)))
    assert len(repr(asked)) < 500
    assert len(repr(Shape(BODY, PITCH_M, np.eye(4)))) < 200


def test_the_mesh_encloses_the_body():
    mesh = RESULT.mesh()
    a, b, c = (mesh.vertices_m[mesh.faces[:, corner]].astype(np.float64) for corner in range(3))
    volume_m3 = (a * np.cross(b, c)).sum() / 6.0
    assert volume_m3 == pytest.approx(RESULT.deformed.sum() * PITCH_M**3, rel=0.04)


def test_what_was_not_asked_for_is_named():
    bare = Result("id", ("m", "1"), GRID, None, None, None, (), frozenset())
    with pytest.raises(NotInReply, match="'reconstruction'"):
        _ = bare.reconstruction
    with pytest.raises(NotInReply, match="'reconstruction'"):
        bare.mesh("observed")
