"""What a picture must show, read back from its pixels."""

from __future__ import annotations

import subprocess
import sys

import cv2
import numpy as np
import pytest

from service.core.grids import Grid
from service.picture import deformation_picture
from service.picture.figure import _nice_length

PITCH_M = 0.004
PANEL_PX = 200


def _grid() -> Grid:
    """A body half a metre before a camera that looks 30° down."""
    up = np.array([0.0, -np.cos(np.radians(30)), -np.sin(np.radians(30))])
    camera_from_grid = np.eye(4)
    camera_from_grid[:3, 0] = (1.0, 0.0, 0.0)
    camera_from_grid[:3, 1] = np.cross(up, camera_from_grid[:3, 0])
    camera_from_grid[:3, 2] = up
    foot_m = np.array([32, 32, 0]) * PITCH_M
    camera_from_grid[:3, 3] = np.array([0.0, 0.05, 0.5]) - camera_from_grid[:3, :3] @ foot_m
    return Grid(PITCH_M, camera_from_grid)


def _bar(shift: int) -> np.ndarray:
    bar = np.zeros((64, 64, 64), bool)
    for height in range(40):
        lean = round(shift * (height / 40) ** 2)
        bar[26 + lean : 38 + lean, 26:38, height] = True
    return bar


def _picture(**changes: object) -> np.ndarray:
    deformed = _bar(12)
    displacement_m = np.zeros((3, 64, 64, 64), np.float32)
    displacement_m[0] = deformed * (np.arange(64) / 40) ** 2 * 12 * PITCH_M
    grid = _grid()
    contact_m = grid.camera_from_grid[:3, :3] @ (np.array([26, 32, 36]) * PITCH_M) + grid.camera_from_grid[:3, 3]
    arguments: dict[str, object] = {
        "depth_m": np.full((480, 640), 0.5, np.float32),
        "observed": _bar(0) & (np.indices((64, 64, 64))[1] == 26),
        "reconstruction": _bar(0),
        "deformed": deformed,
        "displacement_m": displacement_m,
        "grid": grid,
        "intrinsics": (600.0, 600.0, 320.0, 240.0),
        "contact_m": contact_m,
        "force_n": np.array([2.0, 0.0, 0.0]),
        "caption": "silicone",
        "panel_px": PANEL_PX,
    }
    png = deformation_picture(**(arguments | changes))  # type: ignore[arg-type]
    image = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(image[..., ::-1])


def _panel(image: np.ndarray, from_right: int) -> np.ndarray:
    left = image.shape[1] - 110 - (from_right + 1) * PANEL_PX - from_right * 14
    return np.asarray(image[84 : 84 + PANEL_PX, left : left + PANEL_PX].astype(int))


def _red(panel: np.ndarray) -> np.ndarray:
    """Pixels in the colour of the force arrow."""
    return np.asarray(np.abs(panel - (0xD3, 0x12, 0x2F)).sum(-1) < 12)


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    return _picture()


def test_there_are_four_panels_of_equal_size(image: np.ndarray) -> None:
    assert image.shape == (84 + PANEL_PX + 10, 14 + 4 * PANEL_PX + 3 * 14 + 110, 3)


def test_every_panel_but_the_observed_carries_the_force(image: np.ndarray) -> None:
    assert [bool(_red(_panel(image, n)).sum() > 100) for n in (3, 2, 1, 0)] == [True, False, True, True]


def test_the_arrow_runs_in_the_direction_of_the_force(image: np.ndarray) -> None:
    # The head is the thick end; the force is to the right, seen from a camera that looks at it from the front.
    columns = _red(_panel(image, 0)).sum(0)
    used = np.flatnonzero(columns)
    middle = (used.min() + used.max()) // 2
    assert columns[middle:].max() > columns[:middle].max()


def test_the_contact_moves_with_the_body(image: np.ndarray) -> None:
    def tip(panel: np.ndarray) -> int:
        return int(np.flatnonzero(_red(panel).any(0)).max())

    still = _panel(_picture(displacement_m=None), 0)
    assert tip(_panel(image, 0)) > tip(still) + 10


def test_the_deformed_body_is_coloured_by_how_far_it_moved(image: np.ndarray) -> None:
    panel = _panel(image, 0)
    warm = (panel[..., 0] - panel[..., 2]) > 60
    cool = (panel[..., 2] - panel[..., 0]) > 15
    assert np.flatnonzero(warm.any(1)).mean() < np.flatnonzero(cool.any(1)).mean()


def test_without_a_displacement_there_is_one_colour_and_no_bar() -> None:
    image = _picture(displacement_m=None)
    assert (image[40:, -88:] == 255).all()


def test_a_known_shape_has_two_panels_and_no_frame() -> None:
    image = _picture(depth_m=None, intrinsics=None, observed=None)
    assert image.shape[1] == 14 + 2 * PANEL_PX + 14 + 110


def test_a_frame_without_any_reading_and_no_force_are_drawn() -> None:
    image = _picture(depth_m=np.full((480, 640), np.nan, np.float32), force_n=np.zeros(3))
    assert _red(_panel(image, 0)).sum() < 100


@pytest.mark.parametrize(("length_m", "nice_m"), [(0.034, 0.02), (0.02, 0.02), (0.0099, 0.005), (0.7, 0.5), (1.3, 1.0)])
def test_ground_lines_stand_at_round_distances(length_m: float, nice_m: float) -> None:
    assert _nice_length(length_m) == pytest.approx(nice_m)


def test_without_matplotlib_the_error_says_what_to_install() -> None:
    hidden = "import sys; sys.modules['matplotlib'] = sys.modules['matplotlib.axes'] = None; import service.picture"
    run = subprocess.run([sys.executable, "-c", hidden], capture_output=True, text=True, timeout=60)
    assert run.returncode == 1
    assert "pip install 'physnet[pictures]'" in run.stderr
