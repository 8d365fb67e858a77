"""The part of a depth image around an object: all that later questions about the same object can point at."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from service.core.arrays import DepthImage, Mask, Vector3
from service.core.camera import PIXEL_WINDOW_RADII, Intrinsics, pixel_to_point
from service.core.errors import InvalidRequest

MARGIN = 0.5
"""Around the object on each side, in its larger side: a contact farther off than 0.15 edges of the grid is refused."""


@dataclass(frozen=True)
class DepthCrop:
    """A window of a depth image.

    Attributes:
        intrinsics: Of the whole image.
        corner_px: (u, v) of the window's first pixel.
        depth_m: The window, a copy, so that the image itself need not be kept.
    """

    intrinsics: Intrinsics
    corner_px: tuple[int, int]
    depth_m: DepthImage

    def point(self, u: float, v: float, field: str) -> Vector3:
        """The surface point at a pixel of the whole image, the one that `pixel_to_point` finds in it.

        Raises:
            InvalidRequest: The pixel lies outside the image or the window, or no reading is near it.
        """
        camera = self.intrinsics
        (left, top), (rows, columns) = self.corner_px, self.depth_m.shape
        in_image = -0.5 <= u < camera.width - 0.5 and -0.5 <= v < camera.height - 0.5
        if in_image and not (left - 0.5 <= u < left + columns - 0.5 and top - 0.5 <= v < top + rows - 0.5):
            raise InvalidRequest(
                "Of an earlier frame only the surroundings of the object are kept, and this pixel lies outside them.",
                field=field,
                expected=f"u in [{left}, {left + columns - 1}], v in [{top}, {top + rows - 1}]",
                actual=f"({u:g}, {v:g})",
            )
        return pixel_to_point(u, v, self.depth_m, camera, corner_px=self.corner_px, field=field)


def crop_around(pixels: Mask, depth_m: DepthImage, intrinsics: Intrinsics) -> DepthCrop:
    """The window around an object's pixels, at least one, from which every contact on or near it can be read."""
    column, row, columns, rows = cv2.boundingRect(pixels.view(np.uint8))
    margin = int(MARGIN * max(rows, columns)) + PIXEL_WINDOW_RADII[-1] + 1
    top, left = max(0, row - margin), max(0, column - margin)
    window = depth_m[top : row + rows + margin, left : column + columns + margin]
    return DepthCrop(intrinsics, (left, top), window.copy())
