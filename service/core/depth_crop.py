"""The part of a depth image around an object: all that later questions about the same object can point at."""

from __future__ import annotations

from dataclasses import dataclass

from service.core.arrays import DepthImage, Vector3
from service.core.camera import PIXEL_WINDOW_RADII, Intrinsics, pixel_to_point
from service.core.depth_view import Window
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


def crop_around(box: Window, depth_m: DepthImage, intrinsics: Intrinsics) -> DepthCrop:
    """The window from which every contact on or near an object can be read, around the box that holds its pixels."""
    rows, columns = box
    margin = int(MARGIN * max(rows.stop - rows.start, columns.stop - columns.start)) + PIXEL_WINDOW_RADII[-1] + 1
    top, left = max(0, rows.start - margin), max(0, columns.start - margin)
    window = depth_m[top : rows.stop + margin, left : columns.stop + margin]
    return DepthCrop(intrinsics, (left, top), window.copy())
