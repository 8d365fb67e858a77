"""Every encoding gives the same metres, and every unusable one is refused by name."""

from __future__ import annotations

import io
import struct
import zlib

import cv2
import numpy as np
import pytest

from service.core.depth import decode_depth, decode_mask
from service.core.errors import EmptyObject, InvalidFrame, PayloadTooLarge, PhysNetError
from service.core.limits import FrameLimits
from service.core.rvl import encode_rvl
from tests.real_frames import load_frame, needs_frames

WIDTH, HEIGHT = 33, 20


def counts_mm() -> np.ndarray:
    counts = np.random.default_rng(3).integers(300, 3000, (HEIGHT, WIDTH)).astype(np.uint16)
    counts[4:9, 5:12] = 0
    return counts


def expected_m() -> np.ndarray:
    metres = counts_mm() * np.float32(0.001)
    metres[counts_mm() == 0] = np.nan
    return metres.astype(np.float32)


def png(image: np.ndarray) -> bytes:
    return cv2.imencode(".png", image)[1].tobytes()


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def compressed_header(a: float = 0.0, b: float = 0.0) -> bytes:
    return struct.pack("<iff", 1, a, b)


def rvl(counts: np.ndarray) -> bytes:
    return struct.pack("<II", counts.shape[1], counts.shape[0]) + encode_rvl(counts.ravel())


def decode(encoding: str, data: bytes, unit_m: float | None = None) -> np.ndarray:
    return decode_depth(encoding, data, unit_m, WIDTH, HEIGHT)


def metres_with_nan() -> np.ndarray:
    return expected_m()


INTEGER_CASES = {
    "png16": ("png16", lambda: png(counts_mm())),
    "npy": ("npy", lambda: npy(counts_mm())),
    "npy with a channel axis": ("npy", lambda: npy(counts_mm()[..., None])),
    "npy in Fortran order": ("npy", lambda: npy(np.asfortranarray(counts_mm()))),
    "npy big-endian": ("npy", lambda: npy(counts_mm().astype(">u2"))),
    "raw 16UC1": ("16UC1", lambda: counts_mm().astype("<u2").tobytes()),
    "compressedDepth png": ("compressedDepth", lambda: compressed_header() + png(counts_mm())),
    "compressedDepth rvl": ("compressedDepth", lambda: compressed_header() + rvl(counts_mm())),
    "compressedDepth by its ROS format string": (
        "16UC1; compressedDepth png",
        lambda: compressed_header(1e-41, 3.0) + png(counts_mm()),
    ),
    "npy float32": ("npy", lambda: npy(metres_with_nan())),
    "npy float64": ("npy", lambda: npy(metres_with_nan().astype(np.float64))),
    "raw 32FC1": ("32FC1", lambda: metres_with_nan().astype("<f4").tobytes()),
}


@pytest.mark.parametrize(("encoding", "make"), INTEGER_CASES.values(), ids=INTEGER_CASES.keys())
def test_every_encoding_gives_the_same_metres(encoding: str, make: object) -> None:
    depth_m = decode(encoding, make())  # type: ignore[operator]
    assert depth_m.dtype == np.float32
    np.testing.assert_allclose(depth_m, expected_m(), rtol=1e-6)


def test_float16_keeps_its_own_precision() -> None:
    np.testing.assert_allclose(decode("npy", npy(expected_m().astype(np.float16))), expected_m(), rtol=1e-3)


def test_memoryviews_are_read_in_place() -> None:
    np.testing.assert_allclose(decode("png16", memoryview(png(counts_mm()))), expected_m(), rtol=1e-6)  # type: ignore[arg-type]


def test_unit_scales_the_counts() -> None:
    np.testing.assert_allclose(decode("png16", png(counts_mm()), 0.0001), expected_m() / 10, rtol=1e-6)
    np.testing.assert_allclose(decode("npy", npy(expected_m() * 1000), 0.001), expected_m(), rtol=1e-6)


@pytest.mark.parametrize("bad", [0.0, -0.5, np.inf, -np.inf, np.nan])
def test_float_values_that_are_no_reading_become_nan(bad: float) -> None:
    metres = np.ones((HEIGHT, WIDTH), np.float32)
    metres[2, 3] = bad
    depth_m = decode("32FC1", metres.tobytes())
    assert np.isnan(depth_m[2, 3])
    assert np.isnan(depth_m).sum() == 1


@pytest.mark.parametrize("encoding", ["compressedDepth", "32FC1; compressedDepth png", "32FC1; compressedDepth rvl"])
def test_quantised_inverse_depth_is_undone(encoding: str) -> None:
    # The publisher's own formula with its defaults: A = z₀(z₀+1), B = 1 − A/z_max, q = ⌊A/z + B⌋.
    quant_a, z_max = 100.0 * 101.0, 10.0
    quant_b = 1.0 - quant_a / z_max
    z_m = np.linspace(0.3, 9.0, WIDTH * HEIGHT, dtype=np.float32).reshape(HEIGHT, WIDTH)
    q = (quant_a / z_m + quant_b).astype(np.uint16)
    q[0, :5] = 0
    body = rvl(q) if encoding.endswith("rvl") else png(q)
    depth_m = decode(encoding, compressed_header(quant_a, quant_b) + body)
    assert np.isnan(depth_m[0, :5]).all()
    step_m = z_m**2 / quant_a  # dz = z²/A · dq
    assert (np.abs(depth_m - z_m)[1:] <= 1.1 * step_m[1:]).all()


def test_32fc1_without_quantisation_parameters_is_refused() -> None:
    with pytest.raises(InvalidFrame, match="quantisation"):
        decode("32FC1; compressedDepth png", compressed_header() + png(counts_mm()))


def truncated_png() -> bytes:
    whole = png(counts_mm())
    return whole[: len(whole) // 2]


def damaged_png() -> bytes:
    whole = bytearray(png(counts_mm()))
    whole[len(whole) // 2] ^= 0xFF
    return bytes(whole)


def bomb_png() -> bytes:
    """A valid header that promises 60000 × 60000 pixels."""
    ihdr = b"IHDR" + struct.pack(">IIBBBBB", 60000, 60000, 16, 0, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + ihdr + struct.pack(">I", zlib.crc32(ihdr))


COLOUR = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
GREY8 = np.full((HEIGHT, WIDTH), 90, np.uint8)

BAD_DEPTH = {
    "truncated PNG": ("png16", truncated_png(), InvalidFrame, "truncated"),
    "damaged PNG": ("png16", damaged_png(), InvalidFrame, "damaged"),
    "8-bit PNG": ("png16", png(GREY8), InvalidFrame, "8-bit grey"),
    "colour PNG": ("png16", png(COLOUR), InvalidFrame, "8-bit colour"),
    "16-bit colour PNG": ("png16", png(COLOUR.astype(np.uint16)), InvalidFrame, "16-bit colour"),
    "not a PNG": ("png16", b"GIF89a" * 20, InvalidFrame, "not a PNG"),
    "no bytes": ("png16", b"", InvalidFrame, "not a PNG"),
    "PNG of another size": ("png16", png(np.ones((HEIGHT, WIDTH + 1), np.uint16)), InvalidFrame, "34x20"),
    "PNG bomb": ("png16", bomb_png(), PayloadTooLarge, "60000x60000"),
    "PNG without a reading": ("png16", png(np.zeros((HEIGHT, WIDTH), np.uint16)), InvalidFrame, "no valid"),
    "float image without a reading": ("32FC1", npy(0)[:0] + b"\xff" * 4 * WIDTH * HEIGHT, InvalidFrame, "no valid"),
    "npy of another size": ("npy", npy(counts_mm().T), InvalidFrame, "20x33"),
    "npy of objects": ("npy", npy(np.array([[{}]])), InvalidFrame, "object"),
    "npy of bytes": ("npy", npy(GREY8), InvalidFrame, "uint8"),
    "npy with three channels": ("npy", npy(COLOUR.astype(np.uint16)), InvalidFrame, "(20, 33, 3)"),
    "npy cut short": ("npy", npy(counts_mm())[:-2], InvalidFrame, "1318"),
    "npy that claims too much": ("npy", npy(np.ones((3, 1), np.uint16)), InvalidFrame, "1x3"),
    "npy header of noise": ("npy", b"\x93NUMPY\x01\x00\x10\x00" + b"\xfe" * 64, InvalidFrame, "not an npy"),
    "not an npy": ("npy", b"PK\x03\x04", InvalidFrame, "not an npy"),
    "raw with a byte missing": ("16UC1", b"\x01" * (2 * WIDTH * HEIGHT - 1), InvalidFrame, "1319"),
    "raw with bytes too many": ("32FC1", b"\x01" * (4 * WIDTH * HEIGHT + 4), InvalidFrame, "2644"),
    "compressedDepth cut in its header": ("compressedDepth", compressed_header(), InvalidFrame, "too short"),
    "RVL of another size": ("compressedDepth", compressed_header() + rvl(counts_mm().T), InvalidFrame, "20x33"),
    "RVL cut short": ("compressedDepth", compressed_header() + rvl(counts_mm())[:-40], InvalidFrame, "ends"),
    "RVL bomb": ("compressedDepth", compressed_header() + b"\xff" * 64, PayloadTooLarge, "4294967295"),
    "unknown encoding": ("jpeg", b"\xff\xd8", InvalidFrame, "jpeg"),
}


def told(error: PhysNetError) -> str:
    return f"{error.message} expected {error.expected} actual {error.actual}"


@pytest.mark.parametrize(("encoding", "data", "error", "says"), BAD_DEPTH.values(), ids=BAD_DEPTH.keys())
def test_unusable_depth_is_refused(encoding: str, data: bytes, error: type[PhysNetError], says: str) -> None:
    with pytest.raises(error) as caught:
        decode(encoding, data)
    assert (caught.value.field or "").startswith("depth")
    assert says in told(caught.value)


@pytest.mark.parametrize("unit_m", [0.0, -0.001, float("nan"), float("inf")])
def test_unusable_units_are_refused(unit_m: float) -> None:
    with pytest.raises(InvalidFrame) as caught:
        decode("png16", png(counts_mm()), unit_m)
    assert caught.value.field == "depth.unit_m"


def test_limits_hold_before_anything_is_decoded() -> None:
    with pytest.raises(PayloadTooLarge, match="bytes"):
        decode_depth("png16", b"x" * 101, None, WIDTH, HEIGHT, FrameLimits(max_bytes=100))
    with pytest.raises(PayloadTooLarge, match="pixels"):
        decode_depth("png16", png(counts_mm()), None, WIDTH, HEIGHT, FrameLimits(max_pixels=WIDTH * HEIGHT - 1))


def test_every_byte_of_damage_is_refused_or_harmless() -> None:
    """No damaged file may end in anything but a named error or an image."""
    whole = png(counts_mm())
    rng = np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(whole)
        damaged[rng.integers(len(whole))] = rng.integers(256)
        try:
            decode("png16", bytes(damaged))
        except PhysNetError as error:
            assert error.field == "depth"


def png_of(pixels: bytes, *, methods: bytes = b"\0\0\0", other: bytes = b"") -> bytes:
    """A 16-bit grey PNG of rows that are filtered already."""

    def chunk(name: bytes, body: bytes) -> bytes:
        return struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body))

    header = struct.pack(">IIBB", WIDTH, HEIGHT, 16, 0) + methods
    packed = zlib.compress(pixels)
    halves = chunk(b"IDAT", packed[:20]) + chunk(b"IDAT", packed[20:])
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + other + halves + chunk(b"IEND", b"")


def rows_of(counts: np.ndarray) -> bytes:
    return b"".join(b"\0" + row.astype(">u2").tobytes() for row in counts)


def test_pixels_in_several_chunks_and_a_row_of_each_filter_are_read() -> None:
    counts = counts_mm()
    np.testing.assert_array_equal(decode("png16", png_of(rows_of(counts))), expected_m())
    for strategy in range(5):  # zlib's strategies make libpng choose other filters
        file = cv2.imencode(".png", counts, [cv2.IMWRITE_PNG_STRATEGY, strategy])[1].tobytes()
        np.testing.assert_array_equal(decode("png16", file), expected_m())


def test_interlaced_rows_are_put_where_they_belong() -> None:
    counts = counts_mm()
    passes = [(0, 0, 8, 8), (0, 4, 8, 8), (4, 0, 8, 4), (0, 2, 4, 4), (2, 0, 4, 2), (0, 1, 2, 2), (1, 0, 2, 1)]  # Adam7
    pixels = b"".join(rows_of(counts[row::down, column::right]) for row, column, down, right in passes)
    np.testing.assert_array_equal(decode("png16", png_of(pixels, methods=b"\0\0\1")), expected_m())


@pytest.mark.parametrize(
    "pixels", [rows_of(counts_mm())[:-1], b"\x05" + rows_of(counts_mm())[1:]], ids=["a byte short", "no such filter"]
)
def test_pixels_that_are_no_image_are_damage(pixels: bytes) -> None:
    with pytest.raises(InvalidFrame, match="damaged"):
        decode("png16", png_of(pixels))


def test_more_pixels_than_the_header_says_are_not_unpacked() -> None:
    """A few kilobytes that unpack to a gigabyte; whatever becomes of them, it takes neither the time nor the memory."""
    import tracemalloc

    bomb = png_of(rows_of(counts_mm()) + bytes(2**26))
    tracemalloc.start()
    try:
        decode("png16", bomb)
    except InvalidFrame:
        pass
    largest = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert largest < 2**22


def test_mask_is_every_nonzero_pixel() -> None:
    grey = np.zeros((HEIGHT, WIDTH), np.uint8)
    grey[3, 4], grey[5, 6] = 1, 255
    mask = decode_mask("png8", png(grey), WIDTH, HEIGHT)
    assert mask.dtype == bool
    assert np.argwhere(mask).tolist() == [[3, 4], [5, 6]]


BAD_MASK = {
    "truncated": (truncated_png(), "truncated"),
    "16-bit": (png(counts_mm()), "16-bit grey"),
    "colour": (png(COLOUR), "8-bit colour"),
    "another size": (png(GREY8[:-1]), "33x19"),
    "not a PNG": (b"\xff\xd8\xff", "not a PNG"),
}


@pytest.mark.parametrize(("data", "says"), BAD_MASK.values(), ids=BAD_MASK.keys())
def test_unusable_masks_are_refused(data: bytes, says: str) -> None:
    with pytest.raises(InvalidFrame) as caught:
        decode_mask("png8", data, WIDTH, HEIGHT)
    assert caught.value.field == "mask"
    assert says in told(caught.value)


def test_a_mask_without_a_pixel_is_an_empty_object() -> None:
    with pytest.raises(EmptyObject) as caught:
        decode_mask("png8", png(np.zeros((HEIGHT, WIDTH), np.uint8)), WIDTH, HEIGHT)
    assert caught.value.field == "mask"


@needs_frames
@pytest.mark.parametrize("name", ["posecnn_000001", "cleargrasp_000000123", "gqcnn_single_object_0"])
def test_real_frames_decode_as_shipped(name: str) -> None:
    frame = load_frame(name)
    size = frame.intrinsics.width, frame.intrinsics.height
    if frame.depth_counts.dtype == np.uint16:
        depth_m = decode_depth("png16", png(frame.depth_counts), frame.unit_m, *size)
    else:
        depth_m = decode_depth("npy", npy(frame.depth_counts[..., None]), None, *size)
    np.testing.assert_array_equal(depth_m, frame.depth_m)
