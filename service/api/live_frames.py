"""Messages of `/v1/live`: a JSON head and binary parts in one frame, small enough to follow a slider.

A binary message is `head_length: uint32, head: JSON, parts…`, little-endian. From the client the head's `parts` maps
`depth` and `mask` to their lengths in bytes; from the service it maps each part's name to what it is and where.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Int16
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import to_json

from service.api.problem import validation_failed
from service.api.replies import levels
from service.api.schemas import DeformBody, LoadBody, MaterialBody
from service.core.arrays import GRID_SIZE, Occupancy, Probability
from service.core.errors import InvalidRequest
from service.core.extent import filled_range
from service.core.grids import filled_voxels, pack_bits
from service.core.messages import DeformResult, LoadResult

_LENGTH = struct.Struct("<I")

MARGIN = 2
"""Voxels kept around a body: its surface lies between the outermost filled voxel and the empty one beyond."""

COARSE = 2
"""Voxels along the edge of a cell of the displacement field, which is smooth: an eighth of the bytes."""

LARGEST = 32000.0
"""Stored value of the largest displacement."""

NOTHING = np.iinfo(np.int16).min
"""Displacement of a cell without a voxel of the body."""


class _Head(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True, frozen=True)


class PushBody(_Head):
    """What may change while the depth frame stays."""

    material: MaterialBody
    loads: list[LoadBody] = Field(min_length=1, max_length=1)
    uncertainty_samples: int = Field(0, ge=0, le=64)
    reconstruct: bool = Field(False, description="Look for the object again, at the new contact.")


class LiveHead(_Head):
    """Head of a message from the client: `request` opens a frame, `push` asks again about the body in it."""

    frame: int = Field(ge=0, description="The client's own number, greater than the one before.")
    request: DeformBody | None = Field(None, description="As for POST /v1/deform, its images as parts of the message.")
    push: PushBody | None = None
    parts: dict[str, int] = Field(default_factory=dict, description="Lengths of `depth` and `mask` in bytes.")
    token: str | None = Field(None, description="Where the service asks for one: browsers set no headers here.")


@dataclass(frozen=True)
class LiveMessage:
    """Attributes:
    head: Its head.
    files: Its parts.
    """

    head: LiveHead
    files: Mapping[str, bytes]


def parse_message(data: bytes | str) -> LiveMessage:
    """A message from the client, a bare head where it is text.

    Raises:
        ValidationFailed: The head is not what it should be.
        InvalidRequest: The parts do not add up.
    """
    head_bytes, rest = (data.encode(), b"") if isinstance(data, str) else _split(data)
    try:
        head = LiveHead.model_validate_json(head_bytes)
    except ValidationError as failure:
        raise validation_failed(failure) from None
    if not head.parts.keys() <= {"depth", "mask"} or min(head.parts.values(), default=0) < 0:
        raise InvalidRequest(
            "The parts of a message are its images.", field="parts", expected=["depth", "mask"],
            actual=", ".join(sorted(head.parts))[:80],
        )  # fmt: skip
    if sum(head.parts.values()) != len(rest):
        raise InvalidRequest(
            "The message is not as long as its parts together.",
            field="parts", expected=sum(head.parts.values()), actual=len(rest),
        )  # fmt: skip
    files, start = {}, 0
    for name, length in head.parts.items():
        files[name] = rest[start : start + length]
        start += length
    return LiveMessage(head, files)


def _split(data: bytes) -> tuple[bytes, bytes]:
    length = _LENGTH.unpack_from(data)[0] if len(data) >= _LENGTH.size else len(data)
    if _LENGTH.size + length > len(data):
        raise InvalidRequest(
            "The message ends within its head.", field="head_length", expected=f"at most {len(data) - _LENGTH.size}",
            actual=length,
        )  # fmt: skip
    return data[_LENGTH.size : _LENGTH.size + length], data[_LENGTH.size + length :]


@dataclass(frozen=True)
class Part:
    """An array as it travels: `value = stored · scale`; `origin` is the voxel at its first element."""

    array: np.ndarray
    origin: tuple[int, int, int] = (0, 0, 0)
    scale: float = 1.0


def answer_parts(result: DeformResult, with_body: bool, threshold: float) -> dict[str, Part]:
    """What the client draws: the first load's displacement, and the body where it has not got it yet.

    The deformed shape is not among them: it is the body carried along, which the client does as finely as it draws.

    Args:
        result: The answer.
        with_body: Whether the body goes along.
        threshold: Of the reconstruction, above which a voxel counts as filled.
    """
    parts: dict[str, Part] = {}
    if with_body:
        parts["rest"] = _field(result.reconstruction_probability, result.reconstruction, threshold)
        if result.observed is not None:
            parts["observed"] = Part(pack_bits(result.observed))
    parts["displacement"] = _displacement(result.loads[0])
    return parts


def encode_answer(head: Mapping[str, Any], parts: Mapping[str, Part]) -> bytes:
    """One binary message; parts begin at multiples of eight bytes from its start, so that they are read in place."""
    described: dict[str, Any] = {}
    offset = 0
    for name, part in parts.items():
        described[name] = {
            "dtype": part.array.dtype.name, "shape": part.array.shape, "origin": part.origin, "scale": part.scale,
            "offset": offset,
        }  # fmt: skip
        offset += _padded(part.array.nbytes)
    text = to_json({**head, "parts": described}, inf_nan_mode="null")
    text += b" " * (_padded(_LENGTH.size + len(text)) - _LENGTH.size - len(text))
    chunks = [_LENGTH.pack(len(text)), text]
    for part in parts.values():
        chunks += [part.array.tobytes(), b"\0" * (_padded(part.array.nbytes) - part.array.nbytes)]
    return b"".join(chunks)


def _padded(length: int) -> int:
    return -(-length // 8) * 8


def _box(occupancy: Occupancy) -> tuple[slice, slice, slice]:
    """The body and `MARGIN` voxels around it, from even to even voxels."""
    first, end = filled_range(occupancy) or ((0, 0, 0), (1, 1, 1))
    x, y, z = (
        slice(max(0, low - MARGIN) // COARSE * COARSE, min(GRID_SIZE, -(-(high + MARGIN) // COARSE) * COARSE))
        for low, high in zip(first, end, strict=True)
    )
    return x, y, z


def _field(probability: Probability, occupancy: Occupancy, threshold: float) -> Part:
    """Probabilities around a body; voxels that are filled for being observed are as sure as one can be."""
    box = _box(occupancy)
    cut, filled = probability[box], occupancy[box]
    found = levels(cut)
    found[filled & (cut <= np.float32(threshold))] = 255
    return Part(found, (box[0].start, box[1].start, box[2].start), 1 / 255)


def _displacement(load: LoadResult) -> Part:
    """The mean displacement of the body's voxels in each cell of 2³, int16, `NOTHING` where there are none."""
    box = _box(load.deformed)
    shape = [(side.stop - side.start) // COARSE for side in box]
    origin = (box[0].start, box[1].start, box[2].start)
    x, y, z = (filled_voxels(load.deformed) - np.array(origin, np.int32)[:, None]) // np.int32(COARSE)
    cell = (x * shape[1] + y) * shape[2] + z
    cells = math.prod(shape)
    count = np.bincount(cell, minlength=cells)
    total = np.stack([np.bincount(cell, along_axis, cells) for along_axis in load.moved_m])
    scale = max(load.max_displacement_m, 1e-9) / LARGEST
    mean: Int16[np.ndarray, "axis=3 cells"] = np.rint(total / (np.maximum(count, 1) * scale)).astype(np.int16)
    mean[:, count == 0] = NOTHING
    return Part(mean.reshape(3, *shape), origin, scale)
