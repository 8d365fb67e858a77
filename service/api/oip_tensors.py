"""Tensors of the Open Inference Protocol: their types, their bytes, and what is wrong with them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from service.core.errors import InvalidRequest
from service.core.manifest import TensorSpec

DTYPES: Mapping[str, np.dtype[Any]] = {
    "BOOL": np.dtype(np.bool_), "UINT8": np.dtype("u1"), "FP16": np.dtype("<f2"), "FP32": np.dtype("<f4"),
    "FP64": np.dtype("<f8"),
}  # fmt: skip
"""The datatypes that models here have, but BYTES, which is strings and of outputs only."""


@dataclass(frozen=True)
class Tensor:
    """What a model takes or gives.

    Attributes:
        datatype: The protocol's name.
        spec: Name and shape; a string in the shape is a free dimension, the same one wherever it has that name.
        optional: Whether a request may leave it out.
    """

    datatype: str
    spec: TensorSpec
    optional: bool = False

    @property
    def name(self) -> str:
        return self.spec.name

    @property
    def dims(self) -> list[int]:
        """The shape with -1 where it is free."""
        return [-1 if isinstance(size, str) else size for size in self.spec.shape]


@dataclass(frozen=True)
class Given:
    """A tensor as it came in: `data` is raw bytes, or elements flattened or nested in lists."""

    name: str
    datatype: str
    shape: Sequence[int]
    data: bytes | memoryview | Sequence[Any]


def read_inputs(given: Sequence[Given], tensors: Sequence[Tensor]) -> dict[str, np.ndarray]:
    """The arrays that a model takes.

    Raises:
        InvalidRequest: A tensor is missing, unknown or twice there, or of another type, shape or length.
    """
    known = {tensor.name: tensor for tensor in tensors}
    arrays: dict[str, np.ndarray] = {}
    sizes: dict[str, int] = {}
    for one in given:
        field = f"inputs[{one.name[:80]}]"
        tensor = known.get(one.name)
        if tensor is None:
            raise InvalidRequest(
                f"The model has no input `{one.name[:80]}`.", field=field, expected=sorted(known), actual=one.name[:80]
            )
        if one.name in arrays:
            raise InvalidRequest(f"The input `{one.name}` is there twice.", field=field, expected="one")
        if one.datatype != tensor.datatype:
            raise InvalidRequest(
                f"The input `{one.name}` is of datatype {tensor.datatype}.",
                field=f"{field}.datatype", expected=tensor.datatype, actual=one.datatype[:40],
            )  # fmt: skip
        _check_shape(one, tensor, field, sizes)
        arrays[one.name] = _array(one, field)
    for tensor in tensors:
        if tensor.name not in arrays and not tensor.optional:
            raise InvalidRequest(
                f"The input `{tensor.name}` is missing.", field=f"inputs[{tensor.name}]", expected="a tensor",
                actual="nothing",
            )  # fmt: skip
    return arrays


def _check_shape(one: Given, tensor: Tensor, field: str, sizes: dict[str, int]) -> None:
    fits = len(one.shape) == len(tensor.spec.shape)
    for found, wanted in zip(one.shape, tensor.spec.shape, strict=False):
        # A free dimension has at least one element, and as many wherever it stands.
        fits = fits and (found == sizes.setdefault(wanted, found) > 0 if isinstance(wanted, str) else found == wanted)
    if not fits:
        expected = [str(sizes.get(size, size) if isinstance(size, str) else size) for size in tensor.spec.shape]
        raise InvalidRequest(
            f"The input `{one.name}` has another shape.",
            field=f"{field}.shape", expected=f"[{', '.join(expected)}]", actual=str(list(one.shape))[:80],
        )  # fmt: skip


def _array(one: Given, field: str) -> np.ndarray:
    dtype, count = DTYPES[one.datatype], math.prod(one.shape)
    if isinstance(one.data, (bytes, memoryview)):
        if len(one.data) != count * dtype.itemsize:
            raise InvalidRequest(
                f"The data of `{one.name}` is not of the length that its shape says.",
                field=f"{field}.data", expected=f"{count * dtype.itemsize} bytes", actual=f"{len(one.data)} bytes",
            )  # fmt: skip
        return np.frombuffer(one.data, dtype).reshape(one.shape)
    try:
        array = np.array(one.data, dtype)
    except (ValueError, TypeError):
        raise InvalidRequest(
            f"The data of `{one.name}` is not a list of numbers.", field=f"{field}.data", expected="numbers"
        ) from None
    if array.size != count:
        raise InvalidRequest(
            f"The data of `{one.name}` is not of the length that its shape says.",
            field=f"{field}.data", expected=f"{count} elements", actual=f"{array.size} elements",
        )  # fmt: skip
    return array.reshape(one.shape)


def to_bytes(array: np.ndarray, datatype: str) -> bytes:
    """Elements in C order, little-endian; each string with its length before it, four bytes."""
    if datatype == "BYTES":
        strings = [str(item).encode() for item in array.ravel()]
        return b"".join(len(string).to_bytes(4, "little") + string for string in strings)
    return np.ascontiguousarray(array, DTYPES[datatype]).tobytes()
