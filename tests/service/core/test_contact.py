import numpy as np
import pytest

from service.core.contact import OFF_BODY, snap_contact, surface_voxels
from service.core.errors import ContactOffBody
from service.core.grids import Grid
from tests.poses import pose

GRID = Grid(pitch_m=0.01, camera_from_grid=pose((0.0, 0.0, 0.5), (0.1, 0.0, 1.0)))
BODY = np.zeros((64, 64, 64), bool)
BODY[20:40, 20:40, 0:30] = True


def in_camera(local_m: tuple[float, float, float]) -> np.ndarray:
    return GRID.camera_from_grid[:3, :3] @ np.array(local_m) + GRID.camera_from_grid[:3, 3]


def test_surface_voxels_are_a_shell_one_voxel_thick() -> None:
    shell = surface_voxels(BODY)
    assert shell.sum() == BODY.sum() - 18 * 18 * 28
    assert not shell[21:39, 21:39, 1:29].any()


def test_a_contact_on_the_surface_stays() -> None:
    contact, snapped = snap_contact(in_camera((0.30, 0.30, 0.305)), BODY, GRID, "loads[0].contact_m")
    assert not snapped
    np.testing.assert_allclose(contact, in_camera((0.30, 0.30, 0.305)))


@pytest.mark.parametrize("local", [(0.305, 0.305, 0.35), (0.305, 0.305, 0.25)])
def test_a_contact_above_or_inside_is_moved_to_the_nearest_surface_voxel(local: tuple[float, float, float]) -> None:
    contact, snapped = snap_contact(in_camera(local), BODY, GRID, "loads[0].contact_m")
    assert snapped
    np.testing.assert_allclose(contact, in_camera((0.305, 0.305, 0.295)), atol=1e-9)


def test_a_contact_far_off_is_refused_with_its_distance() -> None:
    with pytest.raises(ContactOffBody) as caught:
        snap_contact(in_camera((0.305, 0.305, 0.295 + 0.2)), BODY, GRID, "loads[2].contact_m")
    assert caught.value.actual == pytest.approx(0.2, abs=1e-3)
    assert caught.value.expected == pytest.approx(OFF_BODY * 0.64, abs=1e-3)
    assert caught.value.field == "loads[2].contact_m"
