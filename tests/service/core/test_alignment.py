import numpy as np
import pytest

from service.core.alignment import HORIZONTAL_FILL, VERTICAL_FILL, body_grid, body_grid_free, resample
from service.core.errors import EmptyObject
from service.core.grids import Grid
from tests.poses import pose


def wedge(grid: Grid, yaw_rad: float, centre_m: tuple[float, float]) -> np.ndarray:
    """A bar of 0.30 x 0.12 m whose height falls from 0.12 m at its heavy end to 0.06 m, turned about z."""
    index = np.indices((64, 64, 64)).reshape(3, -1).T
    p = (index + 0.5) * grid.pitch_m
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    x = c * (p[:, 0] - centre_m[0]) + s * (p[:, 1] - centre_m[1])
    y = -s * (p[:, 0] - centre_m[0]) + c * (p[:, 1] - centre_m[1])
    top = np.where(x < -0.05, 0.12, 0.06)
    return ((np.abs(x) < 0.15) & (np.abs(y) < 0.06) & (p[:, 2] < top)).reshape(64, 64, 64)


GRID = Grid(pitch_m=0.5 / 64, camera_from_grid=pose((0.3, -0.2, 1.0), (0.1, 0.2, 0.9)))


@pytest.mark.parametrize("yaw_deg", [-170, -95, -30, 0, 10, 45, 80, 120, 179])
def test_axes_do_not_depend_on_how_the_body_was_turned(yaw_deg: float) -> None:
    yaw = np.radians(yaw_deg)
    aligned = body_grid(wedge(GRID, yaw, (0.25, 0.25)), GRID)
    grid_from_body = GRID.camera_from_grid[:3, :3].T @ aligned.camera_from_grid[:3, :3]
    # The heavy end of the wedge is at -x of the bar, the long tail of the third moment at +x.
    expected = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    assert grid_from_body[:, 0] @ expected > np.cos(np.radians(2.0))
    np.testing.assert_allclose(grid_from_body[:, 2], [0.0, 0.0, 1.0], atol=1e-9)
    assert np.linalg.det(grid_from_body) == pytest.approx(1.0)


def test_body_fills_its_grid_and_stands_on_its_floor() -> None:
    aligned = body_grid(wedge(GRID, 0.5, (0.22, 0.28)), GRID)
    body = resample(wedge(GRID, 0.5, (0.22, 0.28)).astype(np.float32), GRID, aligned) > 0.5
    low, high = np.argwhere(body).min(axis=0), np.argwhere(body).max(axis=0) + 1
    assert (high - low)[0] == pytest.approx(64 * HORIZONTAL_FILL, abs=2)
    assert low[2] == 0
    np.testing.assert_allclose((low + high)[:2] / 2, 32, atol=1)
    assert (high - low)[2] <= 64 * VERTICAL_FILL + 1


def test_volume_survives_resampling() -> None:
    body = wedge(GRID, 0.5, (0.25, 0.25))
    aligned = body_grid(body, GRID)
    volume_m3 = body.sum() * GRID.pitch_m**3
    resampled_m3 = (resample(body.astype(np.float32), GRID, aligned) > 0.5).sum() * aligned.pitch_m**3
    assert resampled_m3 == pytest.approx(volume_m3, rel=0.02)


@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.4), (0.3, -0.2, 0.4)])
def test_resampling_is_trilinear_and_falls_to_zero_outside(angles: tuple[float, float, float]) -> None:
    """Upright columns and all others: a sum over the eight voxels around each centre, of zeros outside the source."""
    rng = np.random.default_rng(1)
    field = rng.random((64, 64, 64), np.float32)
    field[np.arange(64) >= rng.integers(0, 66, (64, 64, 1))] = 0.0  # columns of every height, with zeros above
    turned = pose(angles, (0.12, -0.03, -0.02))
    target = Grid(1.1 * GRID.pitch_m, GRID.camera_from_grid @ turned)
    centres = (np.indices((64, 64, 64)).reshape(3, -1) + 0.5) * target.pitch_m
    places = (turned[:3, :3] @ centres + turned[:3, 3:]) / GRID.pitch_m - 0.5
    padded, place = np.pad(field, 1), np.clip(places + 1.0, 0.0, 65.0)
    below = np.minimum(place.astype(int), 64)
    share = place - below
    expected = np.zeros(64**3)
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod([share[axis] if corner[axis] else 1.0 - share[axis] for axis in range(3)], axis=0)
        expected += weight * padded[below[0] + corner[0], below[1] + corner[1], below[2] + corner[2]]
    assert 0.2 < (expected > 0).mean() < 0.9
    np.testing.assert_allclose(resample(field, GRID, target).ravel(), expected, atol=1e-4)


def test_resampling_to_the_same_grid_changes_nothing() -> None:
    field = np.random.default_rng(0).random((64, 64, 64), np.float32)
    np.testing.assert_allclose(resample(field, GRID, GRID), field, atol=1e-5)


def test_outside_the_source_there_is_nothing() -> None:
    ones = np.ones((64, 64, 64), np.float32)
    shifted = Grid(GRID.pitch_m, GRID.camera_from_grid @ pose(translation=(0.25, 0.0, 0.0)))
    result = resample(ones, GRID, shifted)
    assert result[:30].min() > 0.99
    assert result[33:].max() < 1e-4


def test_a_given_up_overrules_the_axes_of_the_grid() -> None:
    tilt = pose((np.radians(25.0), 0.0, 0.0))
    tilt[:3, 3] = 0.25 - tilt[:3, :3] @ np.full(3, 0.25)  # about the middle, so that the body stays inside
    upright = Grid(GRID.pitch_m, np.eye(4))
    tilted = Grid(GRID.pitch_m, tilt)  # the same world seen in a grid whose z leans by 25 degrees
    body = wedge(upright, 0.4, (0.25, 0.25))
    in_tilted = resample(body.astype(np.float32), upright, tilted) > 0.5
    aligned = body_grid(in_tilted, tilted, up=np.array([0.0, 0.0, 1.0]), on_floor=False)
    np.testing.assert_allclose(aligned.camera_from_grid[:3, 2], [0.0, 0.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(aligned.camera_from_grid[:2, 0], [np.cos(0.4), np.sin(0.4)], atol=0.05)


def test_without_up_the_three_principal_axes_are_found() -> None:
    lean = pose((0.0, 0.3, 0.7))
    index = np.indices((64, 64, 64)).reshape(3, -1).T
    p = ((index + 0.5) / 64 - 0.5) @ lean[:3, :3]
    slab = (np.abs(p) < [0.35, 0.2, 0.08]).all(axis=1).reshape(64, 64, 64)
    grid = Grid(1 / 64, np.eye(4))
    axes = body_grid_free(slab, grid).camera_from_grid[:3, :3]
    np.testing.assert_allclose(np.abs(lean[:3, :3].T @ axes), np.eye(3), atol=0.03)
    assert axes[2, 2] > 0
    assert np.linalg.det(axes) == pytest.approx(1.0)


def test_the_grid_encloses_every_voxel_along_the_principal_axes() -> None:
    """Against NumPy's moments of a body that is anything but symmetric."""
    rng = np.random.default_rng(5)
    body = wedge(GRID, 0.7, (0.25, 0.22)) & (rng.random((64, 64, 64)) < 0.3)
    centres = (np.argwhere(body) + 0.5) * GRID.pitch_m
    centred = centres[:, :2] - centres[:, :2].mean(axis=0)
    x = np.linalg.eigh(centred.T @ centred)[1][:, 1]
    x *= np.sign(((centred @ x) ** 3).sum())
    axes = np.array([[x[0], -x[1], 0.0], [x[1], x[0], 0.0], [0.0, 0.0, 1.0]])
    local = centres @ axes
    low, high = local.min(axis=0) - GRID.pitch_m / 2, local.max(axis=0) + GRID.pitch_m / 2
    edge_m = max((high - low)[:2].max() / HORIZONTAL_FILL, (high - low)[2] / VERTICAL_FILL)
    corner = axes @ [*(low + high)[:2] / 2 - edge_m / 2, low[2]]
    found = body_grid(body, GRID, on_floor=False)
    assert found.edge_m == pytest.approx(edge_m, rel=1e-9)
    expected = GRID.camera_from_grid @ np.block([[axes, corner[:, None]], [np.zeros(3), 1.0]])
    np.testing.assert_allclose(found.camera_from_grid, expected, atol=1e-9)


def test_without_up_the_grid_encloses_every_voxel_and_leans_the_way_the_body_does() -> None:
    """The sign of x is that of the third moment along it, to which the voxels' heights count too."""
    index = np.indices((64, 64, 64)).reshape(3, -1).T
    lean = pose((0.2, 0.5, 0.9))[:3, :3]
    p = ((index + 0.5) / 64 - 0.5) @ lean
    reach = 0.16 - 0.3 * (p[:, 0] + 0.1)  # thinner and thinner along x
    body = ((np.abs(p[:, 1]) < reach) & (np.abs(p[:, 2]) < 0.4 * reach) & (p[:, 0] > -0.25)).reshape(64, 64, 64)
    grid = Grid(1 / 64, np.eye(4))
    found = body_grid_free(body, grid)
    x = found.camera_from_grid[:3, 0]
    centres = (np.argwhere(body) + 0.5) / 64
    assert abs(x @ lean[:, 0]) > 0.99
    assert (((centres - centres.mean(axis=0)) @ x) ** 3).sum() > 0.0
    local = (centres - found.camera_from_grid[:3, 3]) @ found.camera_from_grid[:3, :3]
    np.testing.assert_allclose((local.min(axis=0) + local.max(axis=0))[:2] / 2, found.edge_m / 2, atol=1e-9)
    assert local[:, 2].min() == pytest.approx(grid.pitch_m / 2)


def test_an_empty_grid_is_an_empty_object() -> None:
    with pytest.raises(EmptyObject):
        body_grid(np.zeros((64, 64, 64), bool), GRID)
