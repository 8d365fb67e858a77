import numpy as np
import pytest

from service.core.camera import make_intrinsics
from service.core.grids import Grid
from service.core.voxels import (
    EDGE_OVER_EXTENT,
    FREE_MARGIN_VOXELS,
    FRONT_MARGIN,
    VoxelView,
    carve_free,
    rule_out,
    view_axes,
    view_grid,
    voxelize,
    voxelize_points,
)
from tests.synthetic_scenes import CAMERA, Box, TableScene, render

BOX = Box((-0.05, -0.05, 0.0), (0.05, 0.05, 0.12))


def points_of(scene: TableScene, index: int = 0) -> np.ndarray:
    rows, columns = np.nonzero(scene.shown == index)
    z = scene.depth_m[rows, columns]
    rays = [(columns - CAMERA.cx) / CAMERA.fx, (rows - CAMERA.cy) / CAMERA.fy, np.ones(len(rows))]
    return (np.stack(rays, axis=1) * z[:, None]).astype(np.float32)


def true_occupancy(scene: TableScene, grid: Grid, box: Box) -> np.ndarray:
    index = np.indices((64, 64, 64)).reshape(3, -1).T
    table_from_grid = np.linalg.inv(scene.camera_from_table) @ grid.camera_from_grid
    centres = (index + 0.5) * grid.pitch_m @ table_from_grid[:3, :3].T + table_from_grid[:3, 3]
    return ((centres > box.low) & (centres < box.high)).all(axis=1).reshape(64, 64, 64)


def test_view_axes_are_upright_and_look_away_from_the_camera() -> None:
    scene = render([BOX])
    rotation = view_axes(scene.up)[:3, :3]
    np.testing.assert_allclose(rotation.T @ rotation, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation[:, 2], scene.up, atol=1e-12)
    assert rotation[2, 0] > 0.5  # x goes away from the camera


def test_view_axes_of_a_camera_that_looks_straight_down_follow_the_image() -> None:
    rotation = view_axes(np.array([0.0, 0.0, -1.0]))[:3, :3]
    np.testing.assert_allclose(rotation[:, 0], [0.0, -1.0, 0.0], atol=1e-12)


def test_view_grid_stands_on_the_support_and_leaves_room_behind() -> None:
    scene = render([BOX])
    points = points_of(scene)
    grid = view_grid(points, scene.up, scene.offset_m)
    floor = grid.camera_from_grid[:3, 3]
    assert scene.up @ floor + scene.offset_m == pytest.approx(0.0, abs=1e-6)
    local = (points - floor) @ grid.camera_from_grid[:3, :3]
    # The front face is the nearest; 0.5 % of the points may lie before it.
    assert np.percentile(local[:, 0], 0.5) == pytest.approx(FRONT_MARGIN * grid.edge_m, rel=1e-3)
    assert grid.edge_m == pytest.approx(EDGE_OVER_EXTENT * 0.12, rel=0.03)


def test_voxelize_keeps_observed_free_and_unknown_apart() -> None:
    scene = render([BOX])
    view = voxelize(points_of(scene), scene.depth_m, CAMERA, scene.up, scene.offset_m)
    truth = true_occupancy(scene, view.grid, BOX)
    assert not (view.observed & view.free).any()
    assert not (truth & view.free).any(), "a ray has gone through the solid"
    # Every point of the surface lies in an observed voxel, and each of these touches the body.
    padded = np.pad(truth, 1)
    near = np.any([padded[x : x + 64, y : y + 64, z : z + 64] for x, y, z in np.ndindex(3, 3, 3)], axis=0)
    assert not (view.observed & ~near).any()
    unknown = ~view.observed & ~view.free
    assert truth[unknown].sum() > 0.8 * truth.sum(), "the inside of the body is unknown"
    # Nothing hides the space between camera and body.
    assert view.free[:3].mean() > 0.95


def test_carving_asks_the_reading_at_each_centres_pixel() -> None:
    scene = render([BOX])
    depth_m = scene.depth_m.copy()
    depth_m[200:220] = np.nan
    # Large enough that a part of it lies outside the image.
    grid = Grid(0.02, view_grid(points_of(scene), scene.up, scene.offset_m).camera_from_grid)
    index = np.indices((64, 64, 64)).reshape(3, -1).T + 0.5
    centres = index * grid.pitch_m @ grid.camera_from_grid[:3, :3].T + grid.camera_from_grid[:3, 3]
    u = np.rint(CAMERA.fx * centres[:, 0] / centres[:, 2] + CAMERA.cx)
    v = np.rint(CAMERA.fy * centres[:, 1] / centres[:, 2] + CAMERA.cy)
    seen = (u >= 0) & (u < CAMERA.width) & (v >= 0) & (v < CAMERA.height) & (centres[:, 2] > 0.0)
    reading = np.full(len(centres), np.nan)
    reading[seen] = depth_m[v[seen].astype(int), u[seen].astype(int)]
    expected = (reading > centres[:, 2] + FREE_MARGIN_VOXELS * grid.pitch_m).reshape(64, 64, 64)
    assert expected.any() and not seen.all()
    # Places half-way between two pixels may be rounded either way.
    assert (carve_free(depth_m, CAMERA, grid) != expected).sum() <= 5


def test_nothing_is_free_where_the_sensor_gives_no_reading() -> None:
    scene = render([BOX])
    grid = view_grid(points_of(scene), scene.up, scene.offset_m)
    blind = np.full_like(scene.depth_m, np.nan)
    assert not carve_free(blind, CAMERA, grid).any()


def test_voxels_behind_the_camera_or_outside_the_image_are_unknown() -> None:
    behind = np.eye(4)
    behind[:3, 3] = (0.0, 0.0, -1.0)
    far = np.full((480, 640), 5.0, np.float32)
    assert not carve_free(far, CAMERA, Grid(0.001, behind)).any()
    aside = np.eye(4)
    aside[:3, 3] = (3.0, 0.0, 1.0)
    assert not carve_free(far, CAMERA, Grid(0.001, aside)).any()


def test_carving_follows_the_lens_distortion() -> None:
    distorted = make_intrinsics(600.0, 600.0, 319.5, 239.5, 640, 480, distortion=(-0.2, 0.05, 0.0, 0.0))
    scene = render([BOX], intrinsics=distorted)
    grid = view_grid(points_of(render([BOX])), scene.up, scene.offset_m)
    truth = true_occupancy(scene, grid, BOX)
    assert not (truth & carve_free(scene.depth_m, distorted, grid)).any()


def test_points_outside_the_grid_are_left_out() -> None:
    grid = Grid(pitch_m=0.1, camera_from_grid=np.eye(4))
    occupied = voxelize_points(np.array([[0.05, 0.15, 0.25], [-0.01, 0.1, 0.1], [6.5, 0.1, 0.1]], np.float32), grid)
    assert occupied.sum() == 1
    assert occupied[0, 1, 2]


def test_each_point_marks_its_own_voxel() -> None:
    rng = np.random.default_rng(2)
    points = rng.uniform(-1.0, 7.5, (1000, 3)).astype(np.float32)
    index = np.floor(points.astype(np.float64) / 0.1).astype(int)
    expected = np.zeros((64, 64, 64), bool)
    expected[tuple(index[((index >= 0) & (index < 64)).all(axis=1)].T)] = True
    found = voxelize_points(points, Grid(pitch_m=0.1, camera_from_grid=np.eye(4)))
    assert expected.sum() > 400
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("n", [1, 2, 40, 5000])
def test_stray_points_do_not_stretch_the_grid(n: int) -> None:
    """However they are spread: against NumPy's percentiles of all the points."""
    points = np.random.default_rng(n).standard_t(1.5, (n, 3)).astype(np.float32)  # heavy tails
    points[::3, 0] = 1.0  # many that are equal
    rotation = view_axes(np.array([0.0, -1.0, 0.0]))[:3, :3]
    low, high = np.percentile(points @ rotation, [0.5, 99.5], axis=0)
    low[2] = -0.3
    grid = view_grid(points, np.array([0.0, -1.0, 0.0]), 0.3)
    assert grid.edge_m == pytest.approx(EDGE_OVER_EXTENT * max((high - low).max(), 1e-3), rel=1e-5)
    floor = rotation.T @ grid.camera_from_grid[:3, 3]
    assert floor[0] == pytest.approx(low[0] - FRONT_MARGIN * grid.edge_m, rel=1e-4, abs=1e-5)


def test_what_was_measured_empty_is_ruled_out_and_nothing_else() -> None:
    rng = np.random.default_rng(3)
    probability = rng.random((64, 64, 64), np.float32)
    view = seen_from(80.0, top=30)
    view = VoxelView(view.grid, view.observed, rng.random((64, 64, 64)) < 0.4)
    ruled = probability.copy()
    rule_out(ruled, view)
    empty = view.free | (np.arange(64) >= 31)
    np.testing.assert_array_equal(ruled, np.where(empty, np.float32(0.0), probability))


def seen_from(camera_height_voxels: float, top: int) -> VoxelView:
    """A block of which the camera at that height saw a side, up to some layer."""
    observed = np.zeros((64, 64, 64), bool)
    observed[20, 20:30, : top + 1] = True
    camera_from_grid = np.eye(4)
    camera_from_grid[2, 3] = -0.01 * camera_height_voxels
    return VoxelView(Grid(pitch_m=0.01, camera_from_grid=camera_from_grid), observed, ~observed & False)


@pytest.mark.parametrize(("camera_height", "layers"), [(80.0, 31), (31.5, 31), (30.5, 64), (-5.0, 64)])
def test_nothing_stands_higher_than_a_camera_above_saw(camera_height: float, layers: int) -> None:
    assert seen_from(camera_height, top=30).layers == layers


def test_where_nothing_was_seen_nothing_is_known_of_the_height() -> None:
    view = seen_from(80.0, top=30)
    nothing = VoxelView(view.grid, np.zeros_like(view.observed), view.free)
    assert nothing.layers == seen_from(80.0, top=63).layers == 64
