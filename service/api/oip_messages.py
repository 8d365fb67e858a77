"""Messages of `inference.GRPCInferenceService`, in a descriptor pool of their own.

Other programs, NVIDIA's client among them, define the same names in protobuf's default pool; whoever imports both this
service and such a client in one process would be refused by protobuf.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass

_FILE = Path(__file__).resolve().parent / "generated" / "inference_v2.binpb"

(_described,) = FileDescriptorSet.FromString(_FILE.read_bytes()).file

FILE_NAME: str = _described.name
FILE_BYTES: bytes = _described.SerializeToString()
_pool = DescriptorPool()
_pool.Add(_described)

SERVICE = "inference.GRPCInferenceService"
DESCRIPTION: Any = _pool.FindServiceByName(SERVICE)


def message(kind: str, /, **fields: Any) -> Any:
    """A message of the package by its name."""
    return GetMessageClass(_pool.FindMessageTypeByName(f"inference.{kind}"))(**fields)
