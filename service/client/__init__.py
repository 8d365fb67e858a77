"""The Python client: NumPy in, typed results out, over HTTP or gRPC. Needs neither the service nor ONNX Runtime.

    from service.client import Camera, PhysNetClient, Push

    with PhysNetClient("grpc://127.0.0.1:8001") as client:
        result = client.deform(depth, Camera.from_json("camera.json"), Push(contact_px=(365, 215), force_n=(0, 1, 4)))
    print(result.max_displacement_m, result.points_camera().shape)

More of it: docs/client.md.
"""

from service.client.aio import AsyncPhysNetClient
from service.client.client import PhysNetClient
from service.client.errors import ServiceUnreachable, UnexpectedReply
from service.client.frames import Answer
from service.client.question import Camera, Earlier, Image, Push, Question, Shape, question
from service.client.result import Mesh, NotInReply, PushResult, Result
from service.client.retry import Retry
from service.client.transport import NamedMaterial
from service.core.errors import (
    ContactOffBody,
    DeadlineExceeded,
    EmptyObject,
    InvalidCamera,
    InvalidFrame,
    InvalidRequest,
    InvalidShape,
    MaterialOutOfRange,
    NoSupportPlane,
    Overloaded,
    PayloadTooLarge,
    PhysNetError,
    ReconstructionGone,
    Unauthenticated,
    UnknownMaterial,
)

__all__ = [
    "PhysNetClient",
    "AsyncPhysNetClient",
    "Camera",
    "Image",
    "Push",
    "Shape",
    "Earlier",
    "Question",
    "question",
    "Result",
    "PushResult",
    "Mesh",
    "Answer",
    "NamedMaterial",
    "Retry",
    "PhysNetError",
    "ServiceUnreachable",
    "UnexpectedReply",
    "NotInReply",
    "InvalidRequest",
    "InvalidFrame",
    "InvalidCamera",
    "InvalidShape",
    "EmptyObject",
    "NoSupportPlane",
    "ContactOffBody",
    "MaterialOutOfRange",
    "UnknownMaterial",
    "ReconstructionGone",
    "PayloadTooLarge",
    "Unauthenticated",
    "Overloaded",
    "DeadlineExceeded",
]
