import numpy as np
import pytest

from service.core.contact import OFF_BODY, snap_contact, surface_centres, surface_voxels
from service.core.errors import ContactOffBody
from service.core.grids import Grid
from tests.poses import pose

GRID = Grid(pitch_m=0.01, camera_from_grid=pose((0.0, 0.0, 0.5), (0.1, 0.0, 1.0)))
BODY = np.zeros((64, 64, 64), bool)
BODY[20:40, 20:40, 0:30] = True
SURFACE_M = surface_centres(BODY, GRID)


def in_camera(local_m: tuple[float, float, float]) -> np.ndarray:
    return GRID.camera_from_grid[:3, :3] @ np.array(local_m) + GRID.camera_from_grid[:3, 3]


def test_surface_voxels_are_a_shell_one_voxel_thick() -> None:
    shell = surface_voxels(BODY)
    assert shell.sum() == BODY.sum() - 18 * 18 * 28
    assert not shell[21:39, 21:39, 1:29].any()


def test_what_leaves_the_grid_is_surface_on_all_six_sides() -> None:
    full = np.ones((64, 64, 64), bool)
    assert surface_voxels(full).sum() == 64**3 - 62**3
    speckled = np.random.default_rng(0).random((64, 64, 64)) < 0.9
    padded = np.pad(speckled, 1)
    neighbours = [np.roll(padded, step, axis)[1:-1, 1:-1, 1:-1] for axis in range(3) for step in (-1, 1)]
    np.testing.assert_array_equal(surface_voxels(speckled), speckled & ~np.all(neighbours, axis=0))


def test_surface_centres_are_in_metres() -> None:
    assert SURFACE_M.shape == (3, surface_voxels(BODY).sum())
    np.testing.assert_allclose(SURFACE_M.min(axis=1), [0.205, 0.205, 0.005])
    np.testing.assert_allclose(SURFACE_M.max(axis=1), [0.395, 0.395, 0.295])


def test_a_contact_on_the_surface_stays() -> None:
    contact, snapped = snap_contact(in_camera((0.30, 0.30, 0.305)), SURFACE_M, GRID, "loads[0].contact_m")
    assert not snapped
    np.testing.assert_allclose(contact, in_camera((0.30, 0.30, 0.305)))


@pytest.mark.parametrize("local", [(0.305, 0.305, 0.35), (0.305, 0.305, 0.25)])
def test_a_contact_above_or_inside_is_moved_to_the_nearest_surface_voxel(local: tuple[float, float, float]) -> None:
    contact, snapped = snap_contact(in_camera(local), SURFACE_M, GRID, "loads[0].contact_m")
    assert snapped
    np.testing.assert_allclose(contact, in_camera((0.305, 0.305, 0.295)), atol=1e-9)


def test_a_contact_far_off_is_refused_with_its_distance() -> None:
    with pytest.raises(ContactOffBody) as caught:
        snap_contact(in_camera((0.305, 0.305, 0.295 + 0.2)), SURFACE_M, GRID, "loads[2].contact_m")
    assert caught.value.actual == pytest.approx(0.2, abs=1e-3)
    assert caught.value.expected == pytest.approx(OFF_BODY * 0.64, abs=1e-3)
    assert caught.value.field == "loads[2].contact_m"
