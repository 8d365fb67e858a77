"""Run-length and variable-length coding of 16-bit depth images, as ROS compressed_depth_image_transport carries it.

Source: A. D. Wilson, "Fast lossless depth image compression", ISS 2017, listing 1. The image is a sequence of
(number of zeros, number of non-zeros, the non-zeros), every number a chain of nibbles: three bits each, low bits
first, the fourth bit set while more follow. Non-zeros are zigzag-coded differences to the non-zero before them.
Nibbles fill little-endian 32-bit words from the most significant one down.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Int64, UInt16

_LONGEST_CHAIN = 11
"""Nibbles of a 32-bit number; a longer chain is no RVL stream."""


def decode_rvl(stream: bytes | memoryview, count: int) -> UInt16[np.ndarray, " count"]:
    """Decode `count` pixels in row-major order.

    Numbers are read all at once; Python only walks from run to run.

    Raises:
        ValueError: The stream ends early, or its runs do not add up to `count` pixels.
    """
    numbers = _read_numbers(stream)
    runs, first_of_run = _walk_runs(numbers, count)
    lengths = np.array(runs, np.int64)
    is_value = np.repeat(np.arange(len(lengths)) % 2 == 1, lengths)
    value_counts = lengths[1::2]
    total = int(value_counts.sum())
    # Place of every value among the numbers: counted on from the first number of its run.
    offsets = np.repeat(np.array(first_of_run, np.int64) - (np.cumsum(value_counts) - value_counts), value_counts)
    zigzag = numbers[np.arange(total) + offsets]
    pixels = np.zeros(count, np.uint16)
    # Differences wrap modulo 2¹⁶, as they do in the coder.
    pixels[is_value] = np.cumsum((zigzag >> 1) ^ -(zigzag & 1)).astype(np.uint16)
    return pixels


def _read_numbers(stream: bytes | memoryview) -> Int64[np.ndarray, " numbers"]:
    whole = len(stream) - len(stream) % 4
    octets = np.frombuffer(stream, ">u1", whole).reshape(-1, 4)[:, ::-1].ravel()
    nibbles = np.empty(2 * len(octets), np.uint8)
    nibbles[0::2] = octets >> 4
    nibbles[1::2] = octets & 0xF
    ends = np.flatnonzero(nibbles < 8)
    starts = np.concatenate([[0], ends[:-1] + 1]) if len(ends) else ends
    lengths = ends - starts + 1
    if len(lengths) and int(lengths.max()) > _LONGEST_CHAIN:
        raise ValueError("a number is longer than 32 bits")
    numbers = (nibbles[starts] & 7).astype(np.int64)
    longer = np.arange(len(starts))
    for place in range(1, _LONGEST_CHAIN):
        longer = longer[lengths[longer] > place]
        if len(longer) == 0:
            break
        numbers[longer] |= (nibbles[starts[longer] + place] & 7).astype(np.int64) << (3 * place)
    return np.asarray(numbers, np.int64)


def _walk_runs(numbers: Int64[np.ndarray, " numbers"], count: int) -> tuple[list[int], list[int]]:
    """Lengths of the runs (zeros, values, zeros, values, …) and the index of each value run's first number."""
    table = numbers.tolist()
    available = len(table)
    runs: list[int] = []
    first_of_run: list[int] = []
    position, pixels = 0, 0
    while pixels < count:
        if position + 2 > available:
            raise ValueError(f"the stream ends after {pixels} of {count} pixels")
        zeros, values = table[position], table[position + 1]
        runs += (zeros, values)
        first_of_run.append(position + 2)
        position += 2 + values
        pixels += zeros + values
        if zeros + values == 0:
            raise ValueError("an empty run")
    if pixels > count:
        raise ValueError(f"the runs cover {pixels} pixels, the image has {count}")
    if position > available:
        raise ValueError("the stream ends inside a run")
    return runs, first_of_run


def encode_rvl(pixels: UInt16[np.ndarray, " count"]) -> bytes:
    """Encode pixels in row-major order; the inverse of `decode_rvl`."""
    values = pixels[pixels > 0].astype(np.int64)
    deltas = np.diff(values, prepend=0)
    zigzag = (deltas << 1) ^ (deltas >> 63)
    edges = np.flatnonzero(np.diff((pixels > 0).astype(np.int8), prepend=0, append=0))
    starts, ends = edges[0::2], edges[1::2]
    previous_ends = np.concatenate([[0], ends[:-1]]).astype(np.int64)
    numbers: list[np.ndarray] = []
    taken = 0
    for start, end, previous_end in zip(starts, ends, previous_ends, strict=False):
        numbers += [np.array([start - previous_end, end - start]), zigzag[taken : taken + end - start]]
        taken += int(end - start)
    trailing = len(pixels) - (int(ends[-1]) if len(ends) else 0)
    if trailing:
        numbers.append(np.array([trailing, 0]))
    return _write_numbers(np.concatenate(numbers) if numbers else np.empty(0, np.int64))


def _write_numbers(numbers: Int64[np.ndarray, " numbers"]) -> bytes:
    places = np.arange(_LONGEST_CHAIN)
    shifted = numbers[:, None] >> (3 * places)
    used = (shifted > 0) | (places == 0)
    continues = np.concatenate([used[:, 1:], np.zeros((len(numbers), 1), bool)], axis=1)
    nibbles = ((shifted & 7) | (continues << 3)).astype(np.uint8)[used]
    nibbles = np.concatenate([nibbles, np.zeros(-len(nibbles) % 8, np.uint8)])
    octets = (nibbles[0::2] << 4) | nibbles[1::2]
    return bytes(octets.reshape(-1, 4)[:, ::-1].tobytes())
