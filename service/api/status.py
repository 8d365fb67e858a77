"""How each error of `service.core.errors` is called on each wire: one table for both."""

from __future__ import annotations

from typing import NamedTuple

from service.core.errors import (
    ContactOffBody,
    DeadlineExceeded,
    EmptyObject,
    InvalidCamera,
    InvalidFrame,
    InvalidRequest,
    InvalidShape,
    MaterialOutOfRange,
    ModelMismatch,
    NoSupportPlane,
    Overloaded,
    PayloadTooLarge,
    PhysNetError,
    ReconstructionGone,
    Unauthenticated,
    UnknownMaterial,
    UnknownModel,
)


class Status(NamedTuple):
    """Attributes:
    http: HTTP status code.
    grpc: Name of the gRPC status code.
    meaning: What happened and what to do, for `/problems/<code>`.
    """

    http: int
    grpc: str
    meaning: str


# 400: the request contradicts the schema; 422: well formed, but nothing can be computed from it.
STATUS: dict[type[PhysNetError], Status] = {
    InvalidRequest: Status(
        400, "INVALID_ARGUMENT", "A field is missing, unknown, malformed or contradicts another; `field` says which."
    ),
    InvalidFrame: Status(
        422, "INVALID_ARGUMENT", "The depth image or mask cannot be decoded, is empty or not of the camera's size."
    ),
    InvalidCamera: Status(422, "INVALID_ARGUMENT", "Intrinsics, distortion or `up` are not usable numbers."),
    InvalidShape: Status(422, "INVALID_ARGUMENT", "The shape sent for a frame is not 64³ voxels in a rigid pose."),
    EmptyObject: Status(422, "INVALID_ARGUMENT", "No pixel or voxel is left of the object: check mask and roi."),
    NoSupportPlane: Status(
        422, "INVALID_ARGUMENT", "No plane is visible under the object: send `up`, a mask of the object, or both."
    ),
    ContactOffBody: Status(
        422, "INVALID_ARGUMENT", "A contact lies too far from the body; `actual` is the distance in metres."
    ),
    MaterialOutOfRange: Status(
        422, "INVALID_ARGUMENT", "Young's modulus must be positive and Poisson's ratio between 0 and 0.5."
    ),
    UnknownMaterial: Status(
        422, "INVALID_ARGUMENT", "No material of that name; `expected` lists the nearest, /v1/materials all."
    ),
    UnknownModel: Status(404, "NOT_FOUND", "No model of that name and version; `expected` lists those there are."),
    ReconstructionGone: Status(
        410, "NOT_FOUND", "Nothing is kept under this `reconstruction_id` (any more): send the frame or shape again."
    ),
    PayloadTooLarge: Status(413, "RESOURCE_EXHAUSTED", "More bytes or pixels than this service accepts."),
    Unauthenticated: Status(401, "UNAUTHENTICATED", "This service wants `Authorization: Bearer <token>`."),
    # UNAVAILABLE is the code that gRPC's own retry policies act on.
    Overloaded: Status(
        503, "UNAVAILABLE", "The service is starting, stopping or its queue is full: try again after Retry-After."
    ),
    DeadlineExceeded: Status(
        504, "DEADLINE_EXCEEDED", "The request's deadline passed before inference; nothing was computed."
    ),
    ModelMismatch: Status(
        500, "FAILED_PRECONDITION", "A model does not fit its manifest or this service: its operator must act."
    ),
}

INTERNAL = Status(500, "INTERNAL", "The service failed; its log has the details under the request id.")
"""Of everything that is not in the tree."""


def status_of(error: BaseException) -> Status:
    """Status of an error: its own, else that of its nearest ancestor in the table, else `INTERNAL`."""
    for cls in type(error).__mro__:
        if cls in STATUS:
            return STATUS[cls]
    return INTERNAL


def meanings() -> dict[str, Status]:
    """Every code that a client can meet, with its status and meaning."""
    return {cls.code: status for cls, status in STATUS.items()} | {PhysNetError.code: INTERNAL}
