"""Depth images and masks as robots send them, decoded to metres.

Invalid readings follow REP 117 and REP 118: zero in integer images, NaN or ±Inf in float ones; floats that are not
positive count as invalid too, because many exporters write 0 there. Sizes are read from the header and checked before
anything is decoded.
"""

from __future__ import annotations

import io
import math
import struct
from collections.abc import Callable

import numpy as np
from jaxtyping import Float32, Shaped

from service.core.arrays import DepthImage, Mask
from service.core.compiled import compiled
from service.core.errors import EmptyObject, InvalidFrame
from service.core.limits import DEFAULT_LIMITS, FrameLimits, check_bytes, check_size
from service.core.png import PNG_SIGNATURE, decode_grey_png
from service.core.rvl import decode_rvl

DEPTH_ENCODINGS = ("png16", "npy", "16UC1", "32FC1", "compressedDepth")
MASK_ENCODINGS = ("png8",)

INTEGER_UNIT_M = 0.001
FLOAT_UNIT_M = 1.0

_COMPRESSED_DEPTH_HEADER = struct.Struct("<iff")  # ConfigHeader: format, depthQuantA, depthQuantB
_RVL_SIZE = struct.Struct("<II")  # columns, rows


def decode_depth(
    encoding: str,
    data: bytes | memoryview,
    unit_m: float | None,
    width: int,
    height: int,
    limits: FrameLimits = DEFAULT_LIMITS,
) -> DepthImage:
    """Decode a depth image to metres, NaN where there is no reading.

    Args:
        encoding: One of `DEPTH_ENCODINGS`. `16UC1` and `32FC1` are raw little-endian rows. `compressedDepth` is the
            payload of ROS compressed_depth_image_transport; its message's whole format string, such as
            `32FC1; compressedDepth rvl`, is accepted in its place. Without that string the image is 32FC1 where the
            header carries usable quantisation parameters (A > 0, B < 1) and 16UC1 otherwise: the publisher sets
            A = z₀(z₀+1) and B = 1 − A/z_max for float images and leaves both zero for integer ones.
        data: The bytes.
        unit_m: Metres per count; None for 0.001 in integer images and 1.0 in float ones.
        width: Width the camera says, pixels.
        height: Height the camera says, pixels.
        limits: Largest sizes accepted.

    Raises:
        InvalidFrame: The bytes do not decode, differ in size from the camera, or hold no reading at all.
        PayloadTooLarge: More bytes or pixels than `limits` allow.

    Source: REP 118; compressed_depth_image_transport/src/codec.cpp for the inverse quantisation z = A/(q − B).
    """
    check_bytes(data, "depth", limits)
    if unit_m is not None and not (math.isfinite(unit_m) and unit_m > 0.0):
        raise InvalidFrame(
            "The depth unit must be a positive number of metres.",
            field="depth.unit_m",
            expected="> 0",
            actual=str(unit_m),
        )
    kind = "compressedDepth" if "compressedDepth" in encoding else encoding
    decoder = _DECODERS.get(kind)
    if decoder is None:
        raise InvalidFrame(
            "The depth encoding is not known.",
            field="depth.encoding",
            expected=list(DEPTH_ENCODINGS),
            actual=encoding,
        )
    counts = decoder(encoding, data, width, height, limits)
    default_unit_m = INTEGER_UNIT_M if counts.dtype.kind == "u" else FLOAT_UNIT_M
    depth_m, readings = _to_metres(counts, default_unit_m if unit_m is None else unit_m)
    if readings == 0:
        raise InvalidFrame("The depth image holds no valid reading.", field="depth", expected="a reading", actual=0)
    return depth_m


def decode_mask(
    encoding: str, data: bytes | memoryview, width: int, height: int, limits: FrameLimits = DEFAULT_LIMITS
) -> Mask:
    """Decode a mask; every non-zero pixel is the object.

    Args:
        encoding: `png8`, a PNG of one grey channel of at most 8 bits.
        data: The bytes.
        width: Width the camera says, pixels.
        height: Height the camera says, pixels.
        limits: Largest sizes accepted.

    Raises:
        InvalidFrame: The bytes do not decode or differ in size from the camera; `field` is `mask`.
        EmptyObject: No pixel is set.
        PayloadTooLarge: More bytes or pixels than `limits` allow.
    """
    check_bytes(data, "mask", limits)
    if encoding not in MASK_ENCODINGS:
        raise InvalidFrame(
            "The mask encoding is not known.", field="mask.encoding", expected=list(MASK_ENCODINGS), actual=encoding
        )
    mask = decode_grey_png(data, "mask", (1, 2, 4, 8), (width, height), limits) > 0
    if not mask.any():
        raise EmptyObject("The mask has no pixel set.", field="mask", expected="a non-zero pixel", actual=0)
    return np.asarray(mask, np.bool_)


def _to_metres(counts: Shaped[np.ndarray, "height width"], unit_m: float) -> tuple[DepthImage, int]:
    """Counts times their unit in an array of its own, NaN where that is no reading; and how many readings there are."""
    # An overflow to infinity on the way to float32 is no reading.
    with np.errstate(over="ignore", invalid="ignore"):
        unit = np.float32(unit_m)
        # The kernel is compiled for these two alone, and for arrays that could be written.
        if counts.dtype != np.uint16 or not counts.flags.carray:
            counts = counts.astype(np.float32, order="C")
    depth_m = np.empty(counts.shape, np.float32)
    return depth_m, _measure(counts.reshape(-1), unit, depth_m.reshape(-1))


@compiled
def _measure(counts: Shaped[np.ndarray, " n"], unit_m: np.float32, depth_m: Float32[np.ndarray, " n"]) -> int:
    """Counts, uint16 or float32, in metres; NaN for whatever is no positive, finite number of them."""
    readings = np.int32(0)  # half as wide as Python's, so that twice as many are counted at once
    for pixel in range(len(depth_m)):
        z = np.float32(counts[pixel]) * unit_m
        is_reading = (z > np.float32(0.0)) & (z < np.float32(np.inf))
        readings = np.int32(readings + np.int32(is_reading))
        depth_m[pixel] = z if is_reading else np.float32(np.nan)
    return int(readings)


def _decode_png16(
    encoding: str, data: bytes | memoryview, width: int, height: int, limits: FrameLimits
) -> Shaped[np.ndarray, "height width"]:
    return decode_grey_png(data, "depth", (16,), (width, height), limits)


def _decode_npy(
    encoding: str, data: bytes | memoryview, width: int, height: int, limits: FrameLimits
) -> Shaped[np.ndarray, "height width"]:
    # The header alone is parsed and the array is a view of the bytes: nothing is unpickled or allocated.
    stream = io.BytesIO(bytes(data[:16384]))
    try:
        version = np.lib.format.read_magic(stream)
        if version == (1, 0):
            shape, fortran, dtype = np.lib.format.read_array_header_1_0(stream)
        else:
            shape, fortran, dtype = np.lib.format.read_array_header_2_0(stream)
    except (ValueError, TypeError, EOFError) as error:
        raise InvalidFrame("The depth is not an npy file.", field="depth", expected="npy 1.0 or 2.0") from error
    if dtype.str[1:] not in ("u2", "f2", "f4", "f8"):
        raise InvalidFrame(
            "The npy array has a type that is not a depth.",
            field="depth",
            expected=["uint16", "float16", "float32", "float64"],
            actual=str(dtype)[:40],
        )
    if not (len(shape) == 2 or (len(shape) == 3 and shape[2] == 1)):
        raise InvalidFrame(
            "The npy array must have one depth a pixel.",
            field="depth",
            expected="shape (height, width) or (height, width, 1)",
            actual=str(shape)[:80],
        )
    check_size((shape[1], shape[0]), (width, height), "depth", limits)
    body = memoryview(data)[stream.tell() :]
    _check_length(body, width * height * dtype.itemsize)
    return np.frombuffer(body, dtype).reshape((height, width), order="F" if fortran else "C")


def _decode_raw(
    encoding: str, data: bytes | memoryview, width: int, height: int, limits: FrameLimits
) -> Shaped[np.ndarray, "height width"]:
    dtype = np.dtype("<u2" if encoding == "16UC1" else "<f4")
    check_size((width, height), (width, height), "depth", limits)
    _check_length(data, width * height * dtype.itemsize)
    return np.frombuffer(data, dtype).reshape(height, width)


def _decode_compressed_depth(
    encoding: str, data: bytes | memoryview, width: int, height: int, limits: FrameLimits
) -> Shaped[np.ndarray, "height width"]:
    view = memoryview(data)
    header_size = _COMPRESSED_DEPTH_HEADER.size
    if len(view) < header_size + _RVL_SIZE.size:
        raise InvalidFrame(
            "The compressedDepth data is too short.",
            field="depth",
            expected=f"more than {header_size + _RVL_SIZE.size} bytes",
            actual=len(view),
        )
    _, quant_a, quant_b = _COMPRESSED_DEPTH_HEADER.unpack_from(view)
    payload = view[header_size:]
    if bytes(payload[:8]) == PNG_SIGNATURE:
        counts = decode_grey_png(payload, "depth", (16,), (width, height), limits)
    else:
        columns, rows = _RVL_SIZE.unpack_from(payload)
        check_size((columns, rows), (width, height), "depth", limits)
        try:
            counts = decode_rvl(payload[_RVL_SIZE.size :], width * height).reshape(height, width)
        except ValueError as error:
            raise InvalidFrame(
                "The compressedDepth data is neither PNG nor RVL.", field="depth", actual=str(error)
            ) from error
    # A denormal A is what an uninitialised header of an old publisher looks like, not a quantisation.
    quantised = math.isfinite(quant_a) and quant_a > 1e-6 and math.isfinite(quant_b) and quant_b < 1.0
    pixel_type = encoding.partition(";")[0].strip()
    if pixel_type == "32FC1" and not quantised:
        raise InvalidFrame(
            "The compressedDepth header has no usable quantisation parameters for 32FC1.",
            field="depth",
            expected="A > 0, B < 1",
            actual=f"A = {quant_a:g}, B = {quant_b:g}",
        )
    if not quantised or pixel_type == "16UC1":
        return counts
    inverse = counts.astype(np.float32)
    inverse -= np.float32(quant_b)
    return np.where(counts > 0, np.float32(quant_a) / inverse, np.float32(np.nan))


_Decoder = Callable[[str, "bytes | memoryview", int, int, FrameLimits], np.ndarray]
_DECODERS: dict[str, _Decoder] = {
    "png16": _decode_png16,
    "npy": _decode_npy,
    "16UC1": _decode_raw,
    "32FC1": _decode_raw,
    "compressedDepth": _decode_compressed_depth,
}


def _check_length(body: bytes | memoryview, expected: int) -> None:
    if len(body) != expected:
        raise InvalidFrame(
            "The depth has not the number of bytes that its size needs.",
            field="depth",
            expected=f"{expected} bytes",
            actual=len(body),
        )
