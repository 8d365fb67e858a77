"""Colours of displacements, against OpenCV's table of the same map."""

from __future__ import annotations

import cv2
import numpy as np

from service.core.colours import colours_of


def test_they_are_those_of_viridis():
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1].astype(int)
    ours = colours_of(np.linspace(0.0, 0.02, 256), 0.02).astype(int)
    # 17 places joined by lines stay this close to the curve; the eye tells no difference of 6 in 255.
    assert np.abs(ours - table).max() <= 6
    # Whole levels hide single steps, so every fourth.
    assert (np.diff(ours[::4] @ [0.299, 0.587, 0.114]) > 0).all(), "brighter is farther, also on grey paper"


def test_what_lies_outside_is_at_the_ends():
    ends = colours_of(np.array([-1.0, np.nan, 0.0, 5.0, 9.0]), 5.0)
    assert (ends[:3] == ends[0]).all()
    assert (ends[3] == ends[4]).all()
    assert (colours_of(np.zeros(2), 0.0) == ends[0]).all()
