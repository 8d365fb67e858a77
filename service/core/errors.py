"""What can go wrong with a request, as one tree.

    PhysNetError
    ├── InvalidRequest             invalid_request         a field is missing, malformed or contradicts another
    │   ├── InvalidFrame           invalid_frame           the depth image cannot be decoded or holds no reading
    │   ├── InvalidCamera          invalid_camera          intrinsics, distortion or `up` are not usable
    │   ├── InvalidShape           invalid_shape           the occupancy sent in place of a frame is not usable
    │   ├── EmptyObject            empty_object            no pixel or voxel is left of the object
    │   ├── NoSupportPlane         no_support_plane        no plane is visible and `up` was not given
    │   ├── ContactOffBody         contact_off_body        a contact lies too far from the body's surface
    │   ├── MaterialOutOfRange     material_out_of_range   Young's modulus or Poisson's ratio is outside its range
    │   ├── UnknownMaterial        unknown_material        no material of that name; lists the nearest ones
    │   ├── UnknownModel           unknown_model           no model of that name and version; lists those there are
    │   └── ReconstructionGone     reconstruction_gone     no reconstruction is kept under that id, or no longer
    ├── PayloadTooLarge            payload_too_large       more bytes or pixels than the service accepts
    ├── Unauthenticated            unauthenticated         a token is required and was not given
    ├── Overloaded                 overloaded              the queue is full; try again after `retry_after_s`
    ├── DeadlineExceeded           deadline_exceeded       the client's deadline passed before inference
    └── ModelMismatch              model_mismatch          an artefact does not fit its manifest or this service

Errors carry data, not status codes: `service.api.status` maps each class to its HTTP and gRPC status.
"""

from __future__ import annotations

from typing import ClassVar


class PhysNetError(Exception):
    """Root of the tree.

    Args:
        message: One sentence for the person who reads it, saying what to do where that is known.
        field: Path of the offending field in the request, such as `loads[0].contact_m`.
        expected: What would have been accepted.
        actual: What was found.
    """

    code: ClassVar[str] = "internal"

    def __init__(
        self,
        message: str,
        *,
        field: str | None = None,
        expected: str | int | float | list[str] | None = None,
        actual: str | int | float | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        self.field = field
        self.expected = expected
        self.actual = actual


class InvalidRequest(PhysNetError):
    code = "invalid_request"


class InvalidFrame(InvalidRequest):
    code = "invalid_frame"


class InvalidCamera(InvalidRequest):
    code = "invalid_camera"


class InvalidShape(InvalidRequest):
    code = "invalid_shape"


class EmptyObject(InvalidRequest):
    code = "empty_object"


class NoSupportPlane(InvalidRequest):
    code = "no_support_plane"


class ContactOffBody(InvalidRequest):
    """`actual` is the distance from the contact to the body's surface in metres, `expected` the largest accepted."""

    code = "contact_off_body"


class MaterialOutOfRange(InvalidRequest):
    code = "material_out_of_range"


class UnknownMaterial(InvalidRequest):
    """`expected` lists the nearest known names."""

    code = "unknown_material"


class UnknownModel(InvalidRequest):
    """`expected` lists the names, or the version, that there are."""

    code = "unknown_model"


class ReconstructionGone(InvalidRequest):
    code = "reconstruction_gone"


class PayloadTooLarge(PhysNetError):
    code = "payload_too_large"


class Unauthenticated(PhysNetError):
    code = "unauthenticated"


class Overloaded(PhysNetError):
    """Args: retry_after_s: When a retry has a chance, in seconds."""

    code = "overloaded"

    def __init__(self, message: str, *, retry_after_s: float) -> None:
        super().__init__(message)
        self.retry_after_s = retry_after_s


class DeadlineExceeded(PhysNetError):
    code = "deadline_exceeded"


class ModelMismatch(PhysNetError):
    code = "model_mismatch"
