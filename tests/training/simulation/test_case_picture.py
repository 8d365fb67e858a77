"""The picture of a case: that it is one, and that small deformations are drawn so that they can be seen."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.training.simulation.cases import LENGTH_M, OFFSET_M, WIDTH_M, bar_case
from training.simulation.case import PatchForce
from training.simulation.solved_case import solve_case

pytest.importorskip("matplotlib", reason="pictures need matplotlib: pip install 'physnet[pictures]'")

from training.simulation.case_picture import _exaggeration, draw_case


def test_a_picture_shows_the_body_in_the_colours_of_its_scale(tmp_path: Path) -> None:
    contact = OFFSET_M + np.array([LENGTH_M - 0.01, WIDTH_M / 2, WIDTH_M])
    case = bar_case(forces=(PatchForce(contact, np.array([0.0, 0.0, -0.2])),), law="linear")
    draw_case(solve_case(case), [contact], tmp_path / "case.png")
    image = cv2.imread(str(tmp_path / "case.png"))
    assert image is not None
    assert image.shape[1] > 1000
    # both panels hold strongly coloured pixels: the moved end, the stressed root
    saturation = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)[:, :, 1]
    middle = image.shape[1] // 2
    assert (saturation[:, :middle] > 150).sum() > 3000
    assert (saturation[:, middle:] > 150).sum() > 3000


@pytest.mark.parametrize(
    ("peak_m", "times"), [(0.0, 1), (0.05, 1), (0.03, 1), (0.029, 2), (0.006, 10), (1e-5, 5000), (2.5e-8, 2e6)]
)
def test_small_deformations_are_drawn_larger_by_round_numbers(peak_m: float, times: float) -> None:
    assert _exaggeration(peak_m, 1.0) == times
