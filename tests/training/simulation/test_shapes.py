"""Signed distances against closed forms, and what is measured on bodies."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest

from training.simulation.shapes import Field, Shape, min_thickness, normalise, stand, tight_bounds, to_cube, voxelize
from training.simulation.shapes.field import AboveGround, Rounded, SmoothUnion, Stretched, place
from training.simulation.shapes.primitives import (
    Box,
    CappedCone,
    Capsule,
    Cylinder,
    Ellipsoid,
    Extrusion,
    Revolution,
    Sphere,
    Superquadric,
    Torus,
    polygon_distance,
)
from training.simulation.shapes.shape import sample_points

L_PROFILE = ((0.0, 0.0), (1.0, 0.0), (1.0, 0.4), (0.4, 0.4), (0.4, 1.0), (0.0, 1.0))
CUBE = np.array([[-1.5, 1.5]] * 3)


def distance(field: Field, *points: tuple[float, float, float]) -> np.ndarray:
    return Shape("test", field).distance(np.array(points, np.float32))


@pytest.mark.parametrize(
    ("field", "point", "expected"),
    [
        (Box((1, 2, 3)), (0, 0, 0), -1.0),
        (Box((1, 2, 3)), (2, 0, 0), 1.0),
        (Box((1, 2, 3)), (4, 6, 0), 5.0),
        (Box((1, 2, 3)), (2, 4, 5), 3.0),
        (Sphere(0.5), (3, 4, 0), 4.5),
        (Sphere(0.5), (0, 0, 0), -0.5),
        (Cylinder(1, 2), (4, 0, 6), 5.0),
        (Cylinder(1, 2), (0, 0, 1.5), -0.5),
        (Cylinder(1, 2), (0.8, 0, 0), -0.2),
        (Torus(2, 0.5), (0, 2, 0), -0.5),
        (Torus(2, 0.5), (0, 0, 0), 1.5),
        (Torus(2, 0.5), (5, 0, 4), 4.5),
        (Capsule((-1, 0, 0), (1, 0, 0), 0.5), (4, 4, 0), 4.5),
        (Capsule((-1, 0, 0), (1, 0, 0), 0.5), (0.3, 0, 0), -0.5),
        (Ellipsoid((1, 2, 3)), (0, 0, 5), 2.0),
        (Ellipsoid((1, 2, 3)), (0, 0, 0), -1.0),
        (Superquadric((1, 2, 3), 4, 6), (0, 0, 5), 2.0),
        (Superquadric((1, 1, 1), 2, 2), (3, 4, 0), 4.0),
        # A cone of half angle atan(1/2): the slant is 2/√5 along the axis; the point (2, 0, 0) projects onto it.
        (CappedCone(1, 0, 1), (2, 0, 0), 1.5 * 2 / math.sqrt(5)),
        (CappedCone(1, 0, 1), (0, 0, 0), -0.5 * 2 / math.sqrt(5)),
        (CappedCone(1, 0.5, 1), (0, 0, 3), 2.0),
        (Extrusion(L_PROFILE, 0.5), (0.7, 0, 0.7), 0.3),
        (Extrusion(L_PROFILE, 0.5), (0.2, 0, 0.2), -0.2),
        (Extrusion(L_PROFILE, 0.5), (-3, 4.5, 0.5), 5.0),
        (Extrusion(L_PROFILE, 0.5, axis="z"), (0.7, 0.7, 0), 0.3),
        (Revolution(((0, 0), (1, 0), (1, 2), (0, 2))), (0, 0, 1), -1.0),
        (Revolution(((0.5, 0), (1, 0), (1, 2), (0.5, 2))), (0, 0, 1), 0.5),
        (Rounded(Box((1, 1, 1)), 0.25), (3, 0, 0), 1.75),
        (Stretched(Sphere(1), (2, 1, 1)), (2, 0, 0), 0.0),
        (SmoothUnion((Sphere(1).shift(-1), Sphere(1).shift(1)), 0.4), (0, 0, 0), -0.1),
        (Sphere(1) - Sphere(0.5), (0, 0, 0), 0.5),
        (Sphere(1) & AboveGround(0.5), (0, 0, 0), 0.5),
    ],
)
def test_distance_equals_the_closed_form(field: Field, point: tuple[float, float, float], expected: float) -> None:
    assert distance(field, point)[0] == pytest.approx(expected, abs=2e-6)


EXACT = [
    Box((0.6, 0.4, 0.8)),
    Cylinder(0.5, 0.7),
    Torus(0.7, 0.2),
    Capsule((-0.4, 0.1, 0), (0.4, 0, 0.3), 0.3),
    CappedCone(0.7, 0.3, 0.6),
    Extrusion(((-0.5, -0.5), (0.5, -0.5), (0.5, -0.1), (-0.1, -0.1), (-0.1, 0.5), (-0.5, 0.5)), 0.4),
    Rounded(Box((0.4, 0.3, 0.2)), 0.2),
]


@pytest.mark.parametrize("field", EXACT, ids=lambda field: type(field).__name__)
def test_exact_fields_have_unit_slope(field: Field) -> None:
    """|∇d| = 1 almost everywhere (the eikonal equation): by central differences, at 95 % of random points."""
    points = np.random.default_rng(0).uniform(-1.2, 1.2, (4000, 3))
    assert np.quantile(np.abs(slopes(field, points) - 1), 0.95) < 5e-3


NEVER_TOO_FAR = [
    *EXACT,
    Ellipsoid((0.9, 0.3, 0.5)),
    Superquadric((0.9, 0.5, 0.4), 5.0, 1.6),
    Stretched(Torus(0.5, 0.2), (1.6, 1.0, 0.7)),
    SmoothUnion(
        (Sphere(0.5).shift(-0.3), Box((0.3, 0.3, 0.3)).turn("x", 0.7).shift(0.5), Sphere(0.3).shift(z=0.7)), 0.3
    ),
    (Box((0.6, 0.6, 0.6)) | Cylinder(0.3, 1.0)) - Sphere(0.5).shift(0.4, 0.4, 0.4),
]


@pytest.mark.parametrize("field", NEVER_TOO_FAR, ids=lambda field: type(field).__name__)
def test_outside_the_value_is_no_more_than_the_true_distance(field: Field) -> None:
    """The true distance of a point to a body is at most that to any sample inside it."""
    shape = Shape("test", field)
    occupancy, _, region = voxelize(shape, 48)
    samples = sample_points(region, occupancy.shape)
    inside = samples[occupancy.ravel()]
    rng = np.random.default_rng(1)
    points = rng.uniform(-1.5, 1.5, (400, 3)).astype(np.float32)
    value = shape.distance(points)
    outside = value > 0
    true = np.linalg.norm(points[outside, None] - inside[None, rng.permutation(len(inside))[:8000]], axis=2).min(axis=1)
    assert (value[outside] <= true + 1e-5).all()
    # ... and not uselessly small either: half of the distance at least, in the median.
    assert np.median(value[outside] / true) > 0.5


@pytest.mark.parametrize("field", [Ellipsoid((0.9, 0.3, 0.5)), Superquadric((0.9, 0.5, 0.4), 5.0, 1.6)])
def test_gauge_bodies_have_their_exact_surface(field: Ellipsoid | Superquadric) -> None:
    p = getattr(field, "exponent_xy", 2.0)
    q = getattr(field, "exponent_z", 2.0)
    a, b, c = field.semi_axes
    rng = np.random.default_rng(2)
    rays = rng.normal(size=(500, 3))
    norm = ((np.abs(rays[:, 0] / a) ** p + np.abs(rays[:, 1] / b) ** p) ** (q / p) + np.abs(rays[:, 2] / c) ** q) ** (
        1 / q
    )
    surface = (rays / norm[:, None]).astype(np.float32)
    assert np.abs(Shape("test", field).distance(surface)).max() < 2e-6


def test_superquadric_refuses_exponents_that_would_make_it_concave() -> None:
    with pytest.raises(ValueError, match="concave"):
        Superquadric((1, 1, 1), 0.5, 2)


def test_the_distance_to_a_polygon_is_that_to_its_nearest_edge() -> None:
    """More points than a block around a notched polygon, against each edge in NumPy and the turns of its corners."""
    corners = np.array([(-1.0, -1.0), (1.0, -0.8), (0.9, 1.0), (0.1, 0.2), (-0.9, 0.9)])
    points = np.random.default_rng(0).uniform(-1.5, 1.5, (3000, 2)).astype(np.float32)
    edges = np.roll(corners, -1, axis=0) - corners
    out = points[:, None] - corners
    share = np.clip((out * edges).sum(axis=2) / (edges**2).sum(axis=1), 0.0, 1.0)
    expected = np.linalg.norm(out - share[:, :, None] * edges, axis=2).min(axis=1)
    angle = np.arctan2(out[:, :, 1], out[:, :, 0])
    turn = (np.roll(angle, -1, axis=1) - angle + np.pi) % (2 * np.pi) - np.pi
    expected[np.abs(turn.sum(axis=1)) > 1.0] *= -1.0
    found = polygon_distance(tuple(map(tuple, corners.tolist())), points[:, 0], points[:, 1])
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_placements_fold_and_act_in_order() -> None:
    """p ↦ scale · rotation · p + translation: first the turn, then the shift."""
    field = Box((2, 1, 1)).turn("z", math.pi / 2).shift(10, 0, 0)
    assert distance(field, (10, 2, 0), (12, 0, 0)) == pytest.approx([0.0, 1.0], abs=1e-5)
    twice = place(field, scale=2.0, translation=(0, 0, 1))
    assert distance(twice, (20, 4, 1), (25, 0, 1)) == pytest.approx([0.0, 3.0], abs=1e-5)
    assert twice.child == Box((2, 1, 1))
    np.testing.assert_allclose(twice.bounds, [[18, 22], [-4, 4], [-1, 3]], atol=1e-9)


@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_turns_are_right_handed(axis: str) -> None:
    """A quarter turn takes the next axis (cyclically) onto the one after it."""
    following = "xyz"[("xyz".index(axis) + 1) % 3]
    last = "xyz"[("xyz".index(axis) + 2) % 3]
    marker = Sphere(0.1).shift(**{following: 1.0}).turn(axis, math.pi / 2)  # type: ignore[arg-type]
    target = [0.0, 0.0, 0.0]
    target["xyz".index(last)] = 1.0
    assert distance(marker, (target[0], target[1], target[2]))[0] == pytest.approx(-0.1, abs=1e-6)


def test_moved_turns_scales_and_shifts() -> None:
    shape = Shape("box", Box((2, 1, 1))).moved(math.pi / 2, 0.5, (3, 0, 0))
    assert shape.family == "box"
    np.testing.assert_allclose(tight_bounds(shape), [[2.5, 3.5], [-1, 1], [-0.5, 0.5]], atol=0.01)


def test_stretched_scales_each_axis() -> None:
    np.testing.assert_allclose(
        tight_bounds(Shape("ball", Sphere(1)).stretched((2, 1, 0.5))), [[-2, 2], [-1, 1], [-0.5, 0.5]], atol=0.02
    )


def test_bounds_hold_the_body_and_tight_ones_fit_it() -> None:
    field = SmoothUnion((Ellipsoid((0.9, 0.2, 0.3)).turn("y", 0.6), Sphere(0.3).shift(0.2, 0.3, 0.4)), 0.2)
    shape = Shape("test", field)
    fine, pitch, region = voxelize(shape, 160)
    inside = sample_points(region, fine.shape)[fine.ravel()]
    tight = tight_bounds(shape)
    assert (shape.bounds[:, 0] <= inside.min(axis=0)).all() and (inside.max(axis=0) <= shape.bounds[:, 1]).all()
    truth = np.stack([inside.min(axis=0) - pitch / 2, inside.max(axis=0) + pitch / 2], axis=1)
    assert np.abs(tight - truth).max() < 0.01


def test_tight_bounds_of_nothing_say_so() -> None:
    with pytest.raises(ValueError, match="empty"):
        tight_bounds(Shape("nothing", Sphere(0.5) & AboveGround(0.7)))


def test_stand_puts_the_cut_on_the_ground() -> None:
    shape = stand("ball", Sphere(1).shift(5, -3, 2), cut=0.1)
    box = tight_bounds(shape)
    np.testing.assert_allclose(box, [[-1, 1], [-1, 1], [0, 1.8]], atol=0.01)
    # A ball cut at a tenth of its height has a foot of radius √(1 − 0.8²).
    assert distance(shape.field, (0.58, 0, 1e-4), (0.62, 0, 1e-4))[0] < 0 < distance(shape.field, (0.62, 0, 1e-4))[0]


def test_voxelize_in_blocks_equals_every_voxel() -> None:
    shape = Shape("test", Torus(0.7, 0.12).turn("x", 0.4) | Box((0.1, 0.9, 0.05)))
    occupancy, pitch, region = voxelize(shape, 50)
    every = shape.distance(sample_points(region, occupancy.shape)).reshape(occupancy.shape) < 0
    assert np.array_equal(occupancy, every)
    assert max(occupancy.shape) == 50
    np.testing.assert_allclose(region[:, 1] - region[:, 0], pitch * np.array(occupancy.shape))


def test_volume_of_a_voxelized_ball() -> None:
    occupancy, pitch, _ = voxelize(Shape("ball", Sphere(1)), 64)
    assert occupancy.sum() * pitch**3 == pytest.approx(4 / 3 * math.pi, rel=0.005)


def test_to_cube_brings_the_centre_to_the_middle_and_turns_by_yaw() -> None:
    shape = Shape("box", Box((0.2, 0.1, 0.1)).turn("z", -0.5).shift(3, 1, 0.1))
    cube = to_cube(shape, 0.5, (3.0, 1.0), 1.25)
    np.testing.assert_allclose(tight_bounds(cube), [[0.25, 0.75], [0.375, 0.625], [0, 0.25]], atol=0.004)


@pytest.mark.parametrize(("half", "fill"), [((1, 0.4, 0.5), (0.70, 0.28, 0.35)), ((0.5, 0.5, 2), (0.185, 0.185, 0.74))])
def test_normalise_fills_the_cube_as_far_as_it_may(half: tuple[float, float, float], fill: tuple[float, ...]) -> None:
    cube = normalise(stand("box", Box(half)), yaw_rad=0.0)
    box = tight_bounds(cube)
    np.testing.assert_allclose(box[:, 1] - box[:, 0], fill, atol=0.002)
    np.testing.assert_allclose(box[:2].mean(axis=1), 0.5, atol=0.002)
    assert box[2, 0] == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize("thickness", [0.10, 0.16, 0.22])
def test_min_thickness_of_a_table_is_that_of_its_legs(thickness: float) -> None:
    """Width 0.70 and height 0.5 make the grid's edge 1, so the legs are `thickness` of it."""
    legs = [(sx * (0.35 - thickness / 2), sy * (0.35 - thickness / 2)) for sx in (-1, 1) for sy in (-1, 1)]
    top: Field = Box((0.35, 0.35, 0.125)).shift(z=0.375)
    for x, y in legs:
        top = top | Box((thickness / 2, thickness / 2, 0.25)).shift(x, y, 0.25)
    assert min_thickness(stand("table", top)) == pytest.approx(thickness, abs=0.013)


def test_min_thickness_of_a_box_is_its_shortest_side_and_of_a_sheet_almost_nothing() -> None:
    assert min_thickness(stand("box", Box((0.35, 0.35, 0.1)))) == pytest.approx(0.2, abs=0.013)
    assert min_thickness(stand("sheet", Box((0.35, 0.35, 0.01)) | Box((0.01, 0.35, 0.3)))) < 0.05


def test_shapes_survive_pickling() -> None:
    shape = stand("test", Box((1, 2, 3)).turn("x", 0.3) | Sphere(1))
    again = pickle.loads(pickle.dumps(shape))
    assert again == shape
    points = np.random.default_rng(0).normal(size=(10, 3)).astype(np.float32)
    assert np.array_equal(again.distance(points), shape.distance(points))


def slopes(field: Field, points: np.ndarray, step: float = 1e-3) -> np.ndarray:
    """|∇d| by central differences."""
    shape = Shape("test", field)
    gradient = [
        shape.distance((points + step * axis).astype(np.float32))
        - shape.distance((points - step * axis).astype(np.float32))
        for axis in np.eye(3)
    ]
    return np.linalg.norm(np.stack(gradient), axis=0) / (2 * step)
