"""Questions and answers as messages of `physnet.v1`; no channel here."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any

import grpc
import numpy as np
from google.protobuf.json_format import MessageToDict
from google.protobuf.message import DecodeError
from google.rpc import status_pb2

from service.api.generated import deformation_pb2 as pb
from service.client.errors import ServiceUnreachable, UnexpectedReply, problem_error, timed_out
from service.client.frames import Answer, Frame
from service.client.http_wire import at_voxels, displacement_from, occupancy_from, probability_from
from service.client.question import Camera, Earlier, Image, Push, Question, Shape, triple
from service.client.result import PushResult, Result
from service.core.errors import PhysNetError
from service.core.grids import Grid

OPTIONS: list[tuple[str, int]] = [
    # Replies of many loads are larger than gRPC's own 4 MiB; the service bounds them.
    ("grpc.max_receive_message_length", -1),
    ("grpc.max_send_message_length", -1),
    # A radio link that died is noticed within 15 s, also between calls.
    ("grpc.keepalive_time_ms", 10_000),
    ("grpc.keepalive_timeout_ms", 5_000),
    ("grpc.keepalive_permit_without_calls", 1),
    ("grpc.http2.max_pings_without_data", 0),
    # Tries are counted by the client, on both wires alike.
    ("grpc.enable_retries", 0),
    # A service that was restarted is found again within a second.
    ("grpc.initial_reconnect_backoff_ms", 100),
    ("grpc.min_reconnect_backoff_ms", 100),
    ("grpc.max_reconnect_backoff_ms", 1_000),
]

_ENCODINGS = {
    "png16": pb.DEPTH_ENCODING_PNG16,
    "npy": pb.DEPTH_ENCODING_NPY,
    "16UC1": pb.DEPTH_ENCODING_16UC1,
    "32FC1": pb.DEPTH_ENCODING_32FC1,
}


# --- questions --------------------------------------------------------------------------------------------------


def encode(question: Question) -> pb.DeformRequest:
    """The request as a message; what was not given is not there."""
    request = pb.DeformRequest(
        loads=[_push(push) for push in question.pushes],
        outputs=pb.Outputs(**dict.fromkeys(question.outputs, True)),
        uncertainty_samples=question.uncertainty_samples,
        threshold=question.threshold,
        # A service that does not know of it answers in the grid, a thirty times larger reply.
        displacement_form=pb.DISPLACEMENT_FORM_VOXELS if at_voxels(question) else pb.DISPLACEMENT_FORM_GRID,
    )
    if isinstance(question.material, str):
        request.material.name = question.material
    else:
        request.material.young_modulus_pa, request.material.poisson_ratio = map(float, question.material)
    if question.camera is not None:
        request.camera.CopyFrom(_camera(question.camera))
    match question.source:
        case Shape():
            request.shape.CopyFrom(_shape(question.source))
        case Earlier():
            request.reconstruction_id = question.source.reconstruction_id
        case Image():
            request.depth.CopyFrom(_depth(question.source))
    if question.mask is not None:
        request.mask.encoding = pb.MASK_ENCODING_PNG8
        request.mask.data = question.mask.data
    if question.up is not None:
        request.up.CopyFrom(_vector(question.up))
    if question.roi is not None:
        request.roi.CopyFrom(pb.Region(**dict(zip(("u", "v", "width", "height"), question.roi, strict=True))))
    return request


def _camera(camera: Camera) -> pb.Camera:
    return pb.Camera(
        fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy, width=camera.width, height=camera.height,
        distortion=camera.distortion,
    )  # fmt: skip


def _depth(image: Image) -> pb.DepthImage:
    if "compressedDepth" in image.encoding:
        return pb.DepthImage(
            encoding=pb.DEPTH_ENCODING_COMPRESSED_DEPTH, unit_m=image.unit_m, data=image.data,
            ros_format=None if image.encoding == "compressedDepth" else image.encoding,
        )  # fmt: skip
    # An encoding of another name is for the service to refuse, with the list of those there are.
    encoding = _ENCODINGS.get(image.encoding, pb.DEPTH_ENCODING_UNSPECIFIED)
    return pb.DepthImage(encoding=encoding, unit_m=image.unit_m, data=image.data)


def _shape(shape: Shape) -> pb.KnownShape:
    pose = np.asarray(shape.camera_from_grid, np.float64).ravel().tolist()
    return pb.KnownShape(data=shape.bits, voxel_size_m=float(shape.voxel_size_m), camera_from_grid=pose)


def _push(push: Push) -> pb.Load:
    load = pb.Load(force_n=_vector(push.force_n), patch_radius_m=push.patch_radius_m)
    if push.contact_m is not None:
        load.contact_m.CopyFrom(_vector(push.contact_m))
    if push.contact_px is not None:
        u, v = push.contact_px
        load.contact_px.CopyFrom(pb.Pixel(u=float(u), v=float(v)))
    return load


def _vector(vector: Any) -> pb.Vector3:
    x, y, z = triple(vector)
    return pb.Vector3(x=x, y=y, z=z)


# --- answers ----------------------------------------------------------------------------------------------------


def result(response: pb.DeformResponse) -> Result:
    """A response as a result."""
    grid = Grid(response.grid.voxel_size_m, np.array(response.grid.camera_from_grid, np.float64).reshape(4, 4))
    given = response.HasField
    probability = response.reconstruction_probability.levels if given("reconstruction_probability") else None
    return Result(
        request_id=response.request_id,
        model=(response.model.name, response.model.version),
        grid=grid,
        seen=occupancy_from(response.observed.bits) if given("observed") else None,
        body=occupancy_from(response.reconstruction.bits) if given("reconstruction") else None,
        body_probability=None if probability is None else probability_from(probability),
        pushes=tuple(_push_result(load, grid) for load in response.loads),
        flags=frozenset(response.flags),
        timing_ms=dict(response.timing_ms),
        reconstruction_id=response.reconstruction_id if given("reconstruction_id") else None,
    )


def _push_result(load: pb.LoadResult, grid: Grid) -> PushResult:
    deformed = occupancy_from(load.deformed.bits) if load.HasField("deformed") else None
    travelled = None
    if load.HasField("displacement_at_voxels"):
        travelled = load.displacement_at_voxels.float16_m
    elif load.HasField("displacement"):
        travelled = load.displacement.float16_m
    return PushResult(
        grid=grid,
        occupancy=deformed,
        probability=probability_from(load.probability.levels) if load.HasField("probability") else None,
        displacement=None if travelled is None else displacement_from(travelled, deformed),
        max_displacement_m=load.max_displacement_m,
        mean_displacement_m=load.mean_displacement_m,
        load_number=load.load_number,
        flags=frozenset(load.flags),
    )


def problem(message: pb.Problem) -> PhysNetError:
    """A problem in a message as the error it tells of."""
    document = MessageToDict(message, preserving_proto_field_name=True)
    return problem_error(document, message.retry_after_s if message.HasField("retry_after_s") else None)


def error_of(failed: grpc.RpcError, timeout_s: float | None) -> PhysNetError:
    """A failed call as the error it tells of: the problem in its details, else what its status says.

    Args:
        failed: What grpc raised.
        timeout_s: What the call was given, for the words.
    """
    for key, value in _trailers(failed):
        if key == "grpc-status-details-bin":
            try:
                details = status_pb2.Status.FromString(value).details
            except DecodeError:
                break
            for detail in details:
                if detail.Is(pb.Problem.DESCRIPTOR):
                    return problem(pb.Problem.FromString(detail.value))
    code, words = failed.code(), failed.details() or ""
    match code:
        case grpc.StatusCode.DEADLINE_EXCEEDED:
            return timed_out(timeout_s or 0.0)
        # What is cancelled by neither side's wish is a connection that ended.
        case grpc.StatusCode.UNAVAILABLE | grpc.StatusCode.CANCELLED:
            return ServiceUnreachable(f"The service cannot be reached: {words}")
    return UnexpectedReply(f"The call failed with {code.name}: {words}", actual=code.name)


def _trailers(failed: grpc.RpcError) -> Iterable[tuple[str, bytes]]:
    trailing = getattr(failed, "trailing_metadata", None)
    return ((str(key), value) for key, value in ((trailing() if trailing else None) or ()) if isinstance(value, bytes))


# --- streams ----------------------------------------------------------------------------------------------------


def stream_request(frame: Frame, deadline_s: float | None) -> pb.DeformStreamRequest:
    """A frame of a stream as a message."""
    return pb.DeformStreamRequest(
        frame_id=frame.frame_id,
        request=encode(frame.question),
        deadline_ms=None if deadline_s is None else 1e3 * deadline_s,
    )


def stream_answer(response: pb.DeformStreamResponse) -> Answer:
    """What became of a frame, from its response."""
    answer = Answer(response.frame_id, age_ms=dict(response.age_ms))
    match response.WhichOneof("outcome"):
        case "answer":
            return replace(answer, result=result(response.answer))
        case "skipped":
            return replace(answer, overtaken_by=response.skipped.overtaken_by_frame_id)
        case "problem":
            return replace(answer, error=problem(response.problem))
    return replace(answer, error=UnexpectedReply("The response has no outcome that this client knows."))
