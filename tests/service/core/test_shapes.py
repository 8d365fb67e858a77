import numpy as np
import pytest

from service.core.errors import EmptyObject, InvalidShape
from service.core.grids import Grid, pack_bits
from service.core.messages import KnownShape
from service.core.shapes import OWN_FILL, decode_shape, in_own_voxels
from tests.poses import pose

POSE = pose((0.1, 0.2, 0.3), (0.0, 0.1, 0.8))
BODY = np.zeros((64, 64, 64), bool)
BODY[20:40, 25:35, 0:30] = True


def shape(**changes: object) -> KnownShape:
    values: dict[str, object] = {
        "data": pack_bits(BODY).tobytes(), "pitch_m": 0.004, "camera_from_grid": POSE
    }  # fmt: skip
    return KnownShape(**{**values, **changes})  # type: ignore[arg-type]


def test_bits_and_pose_come_back() -> None:
    occupancy, grid = decode_shape(shape())
    np.testing.assert_array_equal(occupancy, BODY)
    assert grid.pitch_m == 0.004


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"data": b"\0" * 100}, "shape.data"),
        ({"pitch_m": 0.0}, "shape.voxel_size_m"),
        ({"pitch_m": float("nan")}, "shape.voxel_size_m"),
        ({"camera_from_grid": 2.0 * np.eye(4)}, "shape.camera_from_grid"),
        ({"camera_from_grid": np.diag([1.0, 1.0, -1.0, 1.0])}, "shape.camera_from_grid"),
        ({"camera_from_grid": np.full((4, 4), np.nan)}, "shape.camera_from_grid"),
    ],
)
def test_what_is_wrong_is_named(changes: dict[str, object], field: str) -> None:
    with pytest.raises(InvalidShape) as caught:
        decode_shape(shape(**changes))
    assert caught.value.field == field


def test_an_empty_shape_is_an_empty_object() -> None:
    with pytest.raises(EmptyObject):
        decode_shape(shape(data=b"\0" * 32768))


def centres_m(body: np.ndarray, grid: Grid) -> np.ndarray:
    """Centres of the filled voxels in the camera frame, metres."""
    local = (np.argwhere(body) + 0.5) * grid.pitch_m
    return np.asarray(local @ grid.camera_from_grid[:3, :3].T + grid.camera_from_grid[:3, 3])


def standing(*extent: int, at: tuple[int, int, int]) -> tuple[np.ndarray, Grid]:
    """A block with a corner missing."""
    body = np.zeros((64, 64, 64), bool)
    body[tuple(slice(a, a + n) for a, n in zip(at, extent, strict=True))] = True
    body[at] = False
    return body, Grid(pitch_m=0.004, camera_from_grid=POSE)


@pytest.mark.parametrize(("extent", "at"), [((20, 30, 40), (22, 17, 0)), ((21, 33, 40), (22, 15, 0))])
def test_a_body_in_the_middle_of_its_floor_keeps_its_grid(
    extent: tuple[int, int, int], at: tuple[int, int, int]
) -> None:
    body, grid = standing(*extent, at=at)
    own = in_own_voxels(body, grid)
    assert own is not None
    assert own[0] is body
    assert own[1] is grid


@pytest.mark.parametrize("at", [(0, 31, 20), (41, 3, 1), (22, 17, 24)])
def test_a_body_elsewhere_is_moved_by_whole_voxels(at: tuple[int, int, int]) -> None:
    """Every voxel keeps its place in the room; the body then stands in the middle of the floor."""
    given, grid = standing(21, 30, 40, at=at)
    own = in_own_voxels(given, grid)
    assert own is not None
    np.testing.assert_allclose(centres_m(*own), centres_m(given, grid), atol=1e-9)
    filled = np.argwhere(own[0])
    np.testing.assert_allclose((filled.min(axis=0) + filled.max(axis=0) + 1)[:2] / 2, 32.0, atol=0.5)
    assert filled[:, 2].min() == 0


def test_a_grid_that_leans_is_not_kept() -> None:
    body, grid = standing(20, 30, 40, at=(22, 17, 0))
    up = POSE[:3, 2]
    nearly, leaning = (up + np.sin(np.radians(angle)) * POSE[:3, 0] for angle in (0.8, 1.2))
    assert in_own_voxels(body, grid, 3.0 * up) is not None
    assert in_own_voxels(body, grid, nearly) is not None
    assert in_own_voxels(body, grid, leaning) is None
    assert in_own_voxels(body, grid, -up) is None


def test_a_grid_that_is_too_large_or_too_tight_is_not_kept() -> None:
    """Of the 44.8 voxels that a body is wide in its body grid, or the 47.4 that it is high."""
    for axis, whole in enumerate((0.70 * 64, 0.70 * 64, 0.74 * 64)):
        for fill, kept in ((OWN_FILL[0] - 0.03, False), (OWN_FILL[0] + 0.03, True),
                           (OWN_FILL[1] - 0.03, True), (OWN_FILL[1] + 0.03, False)):  # fmt: skip
            extent = [4, 4, 4]
            extent[axis] = round(fill * whole)
            assert (in_own_voxels(*standing(*extent, at=(2, 2, 0))) is not None) == kept
