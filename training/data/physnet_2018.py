"""The 280 samples that the authors of 3D-PhysNet released with their code, read without TensorFlow.

A TFRecord file is a ZLIB stream of records (length, checksum, data, checksum); each record is a `tf.train.Example`, a
protobuf message that maps names to lists of bytes, floats or integers. Both are simple enough to read here.

Source: github.com/vividda/3D-PhysNet; framing: tensorflow/core/lib/io/record_writer.h; message:
tensorflow/core/example/feature.proto.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float32, Int, UInt8

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.grids import pack_bits
from training.data.store import Store, StoreError
from training.metrics import iou

_VARINT, _FIXED64, _BYTES, _FIXED32 = 0, 1, 2, 5

HELD_OUT = 84
"""Samples that the splits test on, 30 %."""

Split: TypeAlias = tuple[Int[np.ndarray, " train"], Int[np.ndarray, " test"]]
Value = list[bytes] | Float32[np.ndarray, " n"] | Int[np.ndarray, " n"]


@dataclass(frozen=True)
class PhysNet2018:
    """The release as arrays.

    Attributes:
        rest: Bits of the undeformed body of every sample.
        deformed: Bits of the deformed body.
        label: Four numbers in [0, 1]; the second and third run over 20 × 20 values, Young's modulus and Poisson's ratio
            by all appearances, and the others are constant.
        name: The authors' name of each sample.
    """

    rest: UInt8[np.ndarray, "n 32768"]
    deformed: UInt8[np.ndarray, "n 32768"]
    label: Float32[np.ndarray, "n 4"]
    name: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.name)

    @classmethod
    def load(cls, path: Path) -> PhysNet2018:
        """Read a file of the release.

        Raises:
            StoreError: It is no such file, or it is damaged.
        """
        rest, deformed, label, name = [], [], [], []
        for record in records(path):
            try:
                features = parse_example(record)
                rest.append(pack_bits(_occupancy(features["pcl1"])))
                deformed.append(pack_bits(_occupancy(features["pcl2"])))
                label.append(_numbers(features["label"]))
                name.append(_bytes(features["label_name"])[0].decode())
            except (KeyError, IndexError, ValueError, struct.error) as error:
                raise StoreError(f"{path}: record {len(name)} is no sample of the 2018 release ({error!r})") from error
        if not name:
            raise StoreError(f"{path} holds no record")
        return cls(np.stack(rest), np.stack(deformed), np.stack(label), tuple(name))

    def write(self, store: Store) -> None:
        """Put the samples into a store, a group each, with the labels as they are: their units are not known."""
        for index in range(len(self)):
            bits = [np.unpackbits(grid, bitorder="little") > 0 for grid in (self.rest[index], self.deformed[index])]
            store.write_group(
                index,
                {
                    "rest": self.rest[index],
                    "family": np.array("bridge"),
                    "deformed": self.deformed[index][None],
                    "label": self.label[index][None],
                    "identity_iou": np.array([iou(*bits)], np.float32),
                    "law": np.array(["linear"]),
                    "sample": np.zeros((1, 2), np.float32),
                },
            )
        store.write_manifest({"set": "physnet-2018", "groups": len(self)})


def random_split(count: int, seed: int) -> Split:
    """84 held out at random."""
    order = np.random.default_rng(seed).permutation(count)
    return np.sort(order[HELD_OUT:]), np.sort(order[:HELD_OUT])


def soft_split(stiffness: Float32[np.ndarray, " n"], held_out: int = HELD_OUT) -> Split:
    """The softest held out: nothing trained on moves as far."""
    order = np.argsort(stiffness, kind="stable")
    return np.sort(order[held_out:]), np.sort(order[:held_out])


def grids(bits: UInt8[np.ndarray, "n bytes"]) -> Bool[np.ndarray, "n x y z"]:
    """Packed grids as voxels."""
    return np.unpackbits(bits, axis=1, bitorder="little").reshape(-1, GRID_SIZE, GRID_SIZE, GRID_SIZE) > 0


def records(path: Path) -> Iterator[bytes]:
    """The records of a ZLIB-compressed TFRecord file.

    Raises:
        StoreError: It is not one, it ends within a record, or a checksum is wrong.
    """
    try:
        data = zlib.decompress(path.read_bytes())
    except zlib.error as error:
        raise StoreError(f"{path} is no ZLIB-compressed TFRecord file, or it is cut off: {error}") from error
    place = 0
    while place < len(data):
        if place + 12 > len(data):
            raise StoreError(f"{path} ends within a record")
        size, check = struct.unpack_from("<QI", data, place)
        if masked_crc32c(data[place : place + 8]) != check or place + 16 + size > len(data):
            raise StoreError(f"{path}: the record at byte {place} is damaged")
        yield data[place + 12 : place + 12 + size]
        place += 16 + size


def parse_example(message: bytes) -> dict[str, Value]:
    """The features of a `tf.train.Example`, by name."""
    features: dict[str, Value] = {}
    for _, body in _fields(message, 1):  # Example.features
        for _, entry in _fields(body, 1):  # Features.feature, a map: entries of key and value
            key = next(value for _, value in _fields(entry, 1)).decode()
            for kind, value in (item for item in _fields(next(v for _, v in _fields(entry, 2)))):
                features[key] = _list_of(kind, value)
    return features


def _list_of(kind: int, message: bytes) -> Value:
    """A BytesList (1), FloatList (2) or Int64List (3): its values, packed or not."""
    values = [value for _, value in _fields(message, 1)]
    if kind == 1:
        return values
    if kind == 2:
        return np.frombuffer(b"".join(values), "<f4").astype(np.float32)
    numbers: list[int] = []
    for value in values:
        place = 0
        while place < len(value):
            number, place = _varint(value, place)
            numbers.append(number)
    return np.array(numbers, np.int64)


def _fields(message: bytes, only: int | None = None) -> Iterator[tuple[int, bytes]]:
    """Number and raw content of every field of a protobuf message, in order."""
    place = 0
    while place < len(message):
        tag, place = _varint(message, place)
        number, wire = tag >> 3, tag & 7
        if wire == _VARINT:
            _, end = _varint(message, place)
        elif wire == _FIXED64:
            end = place + 8
        elif wire == _BYTES:
            size, place = _varint(message, place)
            end = place + size
        elif wire == _FIXED32:
            end = place + 4
        else:
            raise ValueError(f"wire type {wire} at byte {place}")
        if end > len(message):
            raise ValueError(f"field {number} is cut off")
        if only is None or number == only:
            yield number, message[place:end]
        place = end


def _varint(data: bytes, place: int) -> tuple[int, int]:
    """A base-128 number and the place after it."""
    value = shift = 0
    while True:
        byte = data[place]
        value |= (byte & 0x7F) << shift
        place, shift = place + 1, shift + 7
        if byte < 0x80:
            return value, place


def _bytes(value: Value) -> list[bytes]:
    if not isinstance(value, list):
        raise ValueError(f"expected bytes, found {value.dtype}")
    return value


def _numbers(value: Value) -> Float32[np.ndarray, " n"]:
    """Floats, or the bytes of floats."""
    if isinstance(value, list):
        return np.frombuffer(value[0], "<f4").astype(np.float32)
    return np.asarray(value, np.float32)


def _occupancy(value: Value) -> Occupancy:
    """Voxel coordinates, three bytes each, to a grid."""
    index = np.frombuffer(_bytes(value)[0], np.uint8).reshape(-1, 3)
    if len(index) == 0 or index.max() >= GRID_SIZE:
        raise ValueError(f"{len(index)} voxels, largest coordinate {index.max(initial=0)}")
    occupancy = np.zeros((GRID_SIZE,) * 3, bool)
    occupancy[tuple(index.T)] = True
    return occupancy


def _crc32c_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        value = byte
        for _ in range(8):
            value = value >> 1 ^ (0x82F63B78 if value & 1 else 0)
        table.append(value)
    return tuple(table)


_TABLE = _crc32c_table()


def masked_crc32c(data: bytes) -> int:
    """CRC-32C (Castagnoli), rotated and shifted as TFRecord stores it."""
    value = 0xFFFFFFFF
    for byte in data:
        value = _TABLE[(value ^ byte) & 0xFF] ^ value >> 8
    value ^= 0xFFFFFFFF
    return ((value >> 15 | value << 17) + 0xA282EAD8) & 0xFFFFFFFF
