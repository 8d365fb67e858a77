"""PNG images of one grey channel, checked chunk by chunk before they are decoded.

Images of 8 and 16 bits are decoded here, in a third of OpenCV's time; all others, and what is unusual about one, are
left to OpenCV.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

import cv2
import deflate
import numpy as np
from jaxtyping import Shaped

from service.core.errors import InvalidFrame
from service.core.limits import FrameLimits, check_size
from service.core.png_filters import unfilter, unfilter_bytes

PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_COLOURS = {0: "grey", 2: "colour", 3: "palette", 4: "grey with alpha", 6: "colour with alpha"}
_PLAIN_CHUNKS = {b"IHDR", b"IDAT", b"IEND", b"pHYs", b"tEXt", b"zTXt", b"iTXt", b"tIME", b"gAMA", b"sRGB", b"cHRM"}
"""Chunks that change nothing about a pixel's number."""


@dataclass(frozen=True)
class _Contents:
    """What a PNG says about itself: its header, the names of its chunks and its compressed pixels, in pieces."""

    bits: int
    colour: int
    methods: bytes
    names: frozenset[bytes]
    pixels: tuple[memoryview, ...]


def decode_grey_png(
    data: bytes | memoryview,
    field: str,
    bit_depths: tuple[int, ...],
    camera_size: tuple[int, int],
    limits: FrameLimits,
) -> Shaped[np.ndarray, "height width"]:
    """Decode a PNG of one grey channel.

    Args:
        data: The file.
        field: Path of the image in the request, for errors.
        bit_depths: Accepted bits per pixel, the largest last; 16 gives uint16, less gives uint8.
        camera_size: (width, height) that the image must have.
        limits: Largest size accepted.

    Raises:
        InvalidFrame: Not a PNG, truncated or damaged, not grey, of another bit depth or another size.
        PayloadTooLarge: More pixels than `limits` allow.
    """
    contents = _check_chunks(data, field, camera_size, limits)
    bits, colour = contents.bits, contents.colour
    if colour != 0 or bits not in bit_depths:
        raise InvalidFrame(
            f"The {field} must be a PNG with one grey channel of {bit_depths[-1]} bits.",
            field=field,
            expected=f"{bit_depths[-1]}-bit grey",
            actual=f"{bits}-bit {_COLOURS.get(colour, f'colour type {colour}')}",
        )
    pixels = _decode_pixels(contents, camera_size) if bits >= 8 else None
    if pixels is not None:
        return pixels
    try:
        image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    except cv2.error:
        image = None
    expected_type = np.uint16 if bit_depths[-1] == 16 else np.uint8
    if image is None or image.shape != camera_size[::-1] or image.dtype != expected_type:
        raise InvalidFrame(f"The {field} is a damaged PNG.", field=field, expected="a PNG that decodes")
    return np.asarray(image)


def _decode_pixels(contents: _Contents, size: tuple[int, int]) -> Shaped[np.ndarray, "height width"] | None:
    """The pixels of an image that is as nearly all are; None where OpenCV had better see for itself."""
    # Compression, filter and interlace method: those of every file that is not interlaced.
    if contents.methods != b"\0\0\0" or not contents.names <= _PLAIN_CHUNKS:
        return None
    width, height = size
    expected = height * (1 + contents.bits // 8 * width)
    try:
        # More bytes than there should be are an error and never written: a small file may hold gigabytes of zeros.
        rows = deflate.zlib_decompress(b"".join(contents.pixels), expected)
    except deflate.DeflateError:
        return None
    if len(rows) != expected:
        return None
    filtered = np.frombuffer(rows, np.uint8).reshape(height, -1)
    if contents.bits == 16:
        counts = np.empty((height, width), np.uint16)
        return counts if unfilter(filtered, counts) else None
    grey = np.empty((height, width), np.uint8)
    return grey if unfilter_bytes(filtered, grey) else None


def _check_chunks(data: bytes | memoryview, field: str, camera_size: tuple[int, int], limits: FrameLimits) -> _Contents:
    """The file's contents, after checking every chunk; a decoder may fill a gap silently."""
    if bytes(data[:8]) != PNG_SIGNATURE or bytes(data[12:16]) != b"IHDR" or len(data) < 33:
        raise InvalidFrame(
            f"The {field} is not a PNG.", field=field, expected="a PNG", actual=bytes(data[:8]).hex(" ") or "no bytes"
        )
    width, height, bits, colour = struct.unpack_from(">IIBB", data, 16)
    check_size((width, height), camera_size, field, limits)
    view = memoryview(data)
    position = 8
    name = b""
    names: set[bytes] = set()
    pixels: list[memoryview] = []
    while name != b"IEND":
        length = int.from_bytes(view[position : position + 4], "big")
        end = position + 12 + length
        if end > len(data):
            raise InvalidFrame(f"The {field} is a truncated PNG.", field=field, expected=end, actual=len(data))
        name = bytes(view[position + 4 : position + 8])
        if deflate.crc32(view[position + 4 : end - 4]) != int.from_bytes(view[end - 4 : end], "big"):
            raise InvalidFrame(
                f"The {field} is a damaged PNG: the checksum of a chunk is wrong.",
                field=field,
                expected="a PNG that decodes",
                actual=f"damaged {name.decode('ascii', 'replace')} chunk",
            )
        names.add(name)
        if name == b"IDAT":
            pixels.append(view[position + 8 : end - 4])
        position = end
    return _Contents(bits, colour, bytes(view[26:29]), frozenset(names), tuple(pixels))
