"""Run-length coding of depth images against a plain loop over the published listing."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from service.core.rvl import decode_rvl, encode_rvl
from tests.real_frames import load_frame, needs_frames


def encode_by_the_listing(pixels: list[int]) -> bytes:
    """The coder as Wilson (2017) prints it: a nibble at a time, words filled from the top."""
    nibbles: list[int] = []

    def put(value: int) -> None:
        while True:
            nibble, value = value & 7, value >> 3
            nibbles.append(nibble | (8 if value else 0))
            if not value:
                return

    position, previous = 0, 0
    while position < len(pixels):
        start = position
        while position < len(pixels) and pixels[position] == 0:
            position += 1
        put(position - start)
        start = position
        while position < len(pixels) and pixels[position] != 0:
            position += 1
        put(position - start)
        for value in pixels[start:position]:
            delta = value - previous
            put((delta << 1) ^ (delta >> 31))
            previous = value
    nibbles += [0] * (-len(nibbles) % 8)
    words = [sum(n << (28 - 4 * i) for i, n in enumerate(nibbles[k : k + 8])) for k in range(0, len(nibbles), 8)]
    return struct.pack(f"<{len(words)}I", *words)


RNG = np.random.default_rng(7)
IMAGES = {
    "all zero": np.zeros(100, np.uint16),
    "no zero": RNG.integers(500, 700, 1000).astype(np.uint16),
    "extremes": np.array([1, 65535, 0, 1, 0, 0, 65535, 65535, 1], np.uint16),
    "alternating": np.tile(np.array([0, 700], np.uint16), 300),
    "holes": np.where(RNG.random(5000) < 0.3, 0, RNG.integers(1, 65536, 5000)).astype(np.uint16),
    "one pixel": np.array([42], np.uint16),
}


@pytest.mark.parametrize("pixels", IMAGES.values(), ids=IMAGES.keys())
def test_coder_writes_the_published_stream(pixels: np.ndarray) -> None:
    assert encode_rvl(pixels) == encode_by_the_listing(pixels.tolist())


@pytest.mark.parametrize("pixels", IMAGES.values(), ids=IMAGES.keys())
def test_decoder_reads_the_published_stream(pixels: np.ndarray) -> None:
    np.testing.assert_array_equal(decode_rvl(encode_by_the_listing(pixels.tolist()), len(pixels)), pixels)


@needs_frames
def test_real_frame_survives_the_round_trip() -> None:
    counts = load_frame("posecnn_000001").depth_counts.ravel()
    stream = encode_rvl(counts)
    assert len(stream) < counts.nbytes / 3
    np.testing.assert_array_equal(decode_rvl(stream, len(counts)), counts)


@pytest.mark.parametrize("cut", [4, 40, 400])
def test_truncated_streams_are_refused(cut: int) -> None:
    stream = encode_rvl(IMAGES["holes"])
    with pytest.raises(ValueError, match="ends"):
        decode_rvl(stream[:-cut], 5000)


def test_streams_of_another_size_are_refused() -> None:
    with pytest.raises(ValueError, match="cover"):
        decode_rvl(encode_rvl(IMAGES["no zero"]), 999)


@pytest.mark.parametrize("stream", [b"", b"\x00" * 64, b"\xff" * 64, bytes(range(256))])
def test_noise_is_refused(stream: bytes) -> None:
    with pytest.raises(ValueError, match=r"ends|empty|longer|cover"):
        decode_rvl(stream, 10_000)
