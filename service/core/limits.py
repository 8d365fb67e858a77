"""How large an image the service accepts, checked from headers before anything is decoded."""

from __future__ import annotations

from dataclasses import dataclass

from service.core.errors import InvalidFrame, PayloadTooLarge


@dataclass(frozen=True)
class FrameLimits:
    """What the service accepts.

    Attributes:
        max_pixels: Of one image; the default is twelve megapixels, more than any depth image aligned to its colour has.
        max_bytes: Of one encoded image; the default holds `max_pixels` of 32-bit floats and a header.
    """

    max_pixels: int = 4096 * 3072
    max_bytes: int = 4 * 4096 * 3072 + 2**12


DEFAULT_LIMITS = FrameLimits()


def check_bytes(data: bytes | memoryview, field: str, limits: FrameLimits) -> None:
    """Refuse more encoded bytes than the limits allow.

    Raises:
        PayloadTooLarge: There are more.
    """
    if len(data) > limits.max_bytes:
        raise PayloadTooLarge(
            f"The {field} has more bytes than the service accepts.",
            field=field,
            expected=f"at most {limits.max_bytes} bytes",
            actual=len(data),
        )


def check_size(found: tuple[int, int], camera: tuple[int, int], field: str, limits: FrameLimits) -> None:
    """Refuse an image that is too large or not of the camera's size; both sizes are (width, height) in pixels.

    Raises:
        PayloadTooLarge: More pixels than the limits allow.
        InvalidFrame: The sizes differ.
    """
    if found[0] * found[1] > limits.max_pixels:
        raise PayloadTooLarge(
            f"The {field} has more pixels than the service accepts.",
            field=field,
            expected=f"at most {limits.max_pixels} pixels",
            actual=f"{found[0]}x{found[1]}",
        )
    if found != camera:
        raise InvalidFrame(
            f"The {field} and the camera differ in size.",
            field=field,
            expected=f"{camera[0]}x{camera[1]}",
            actual=f"{found[0]}x{found[1]}",
        )
