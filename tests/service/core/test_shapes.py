import numpy as np
import pytest

from service.core.errors import EmptyObject, InvalidShape
from service.core.grids import pack_bits
from service.core.messages import KnownShape
from service.core.shapes import decode_shape
from tests.poses import pose

BODY = np.zeros((64, 64, 64), bool)
BODY[20:40, 25:35, 0:30] = True


def shape(**changes: object) -> KnownShape:
    values: dict[str, object] = {
        "data": pack_bits(BODY).tobytes(), "pitch_m": 0.004, "camera_from_grid": pose((0.1, 0.2, 0.3), (0.0, 0.1, 0.8))
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
