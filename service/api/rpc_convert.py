"""Between protobuf and `service.core.messages`, through the checks that the HTTP API makes (`service.api.convert`).

A message becomes the same `DeformBody` that a JSON document does: one set of rules, one set of words, one field path.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from google.protobuf.message import Message
from google.protobuf.struct_pb2 import NULL_VALUE, Value
from google.rpc import error_details_pb2, status_pb2
from grpc import StatusCode
from pydantic import ValidationError

from service.api.generated import deformation_pb2 as pb
from service.api.problem import ValidationFailed, problem_document, validation_failed
from service.api.replies import half_precision, half_precision_at_voxels, levels
from service.api.scene import scene_glb
from service.api.schemas import DeformBody
from service.api.status import status_of
from service.core.arrays import GRID_SIZE
from service.core.errors import Overloaded
from service.core.grids import pack_bits
from service.core.manifest import Manifest
from service.core.materials import MaterialEntry
from service.core.messages import DeformResult, LoadResult

ERROR_DOMAIN = "physnet"

_DEPTH_ENCODINGS: Mapping[int, str] = {
    pb.DEPTH_ENCODING_PNG16: "png16",
    pb.DEPTH_ENCODING_NPY: "npy",
    pb.DEPTH_ENCODING_16UC1: "16UC1",
    pb.DEPTH_ENCODING_32FC1: "32FC1",
    pb.DEPTH_ENCODING_COMPRESSED_DEPTH: "compressedDepth",
}
_MASK_ENCODINGS: Mapping[int, str] = {pb.MASK_ENCODING_UNSPECIFIED: "png8", pb.MASK_ENCODING_PNG8: "png8"}
_DISPLACEMENT_FORMS: Mapping[int, str] = {
    pb.DISPLACEMENT_FORM_UNSPECIFIED: "grid",
    pb.DISPLACEMENT_FORM_GRID: "grid",
    pb.DISPLACEMENT_FORM_VOXELS: "voxels",
}
_OUTPUTS = ("reconstruction", "deformed", "probability", "displacement", "scene")


# --- requests ---------------------------------------------------------------------------------------------------


def parse_request(message: pb.DeformRequest, max_loads: int) -> DeformBody:
    """A message as the request body that the same request in JSON would be.

    Of its loads `max_loads` and one are read: thousands would hold up every other stream, to be refused in the end.

    Raises:
        ValidationFailed: A field is missing or of the wrong form.
    """
    body: dict[str, Any] = {
        "loads": [_load(load) for load in message.loads[: max_loads + 1]],
        "uncertainty_samples": message.uncertainty_samples,
        "displacement_form": _DISPLACEMENT_FORMS.get(message.displacement_form, str(message.displacement_form)),
    }
    for name, translate in _PARTS.items():
        if message.HasField(name):
            body[name] = translate(getattr(message, name))
    try:
        return DeformBody.model_validate(body)
    except ValidationError as failure:
        raise validation_failed(failure) from None


def _given(message: Message, *names: str) -> dict[str, Any]:
    """The fields that were set; one that was not is missing, and no zero."""
    return {name: getattr(message, name) for name in names if message.HasField(name)}


def _camera(camera: pb.Camera) -> dict[str, Any]:
    numbers = _given(camera, "fx", "fy", "cx", "cy", "width", "height")
    return {**numbers, "distortion": list(camera.distortion) or None}


def _depth(depth: pb.DepthImage) -> dict[str, Any]:
    given = _given(depth, "unit_m", "data")
    if depth.encoding != pb.DEPTH_ENCODING_UNSPECIFIED:
        # A number that no encoding has is refused where an unknown name is, under its number.
        given["encoding"] = _DEPTH_ENCODINGS.get(depth.encoding, str(depth.encoding))
    if depth.encoding == pb.DEPTH_ENCODING_COMPRESSED_DEPTH and depth.HasField("ros_format"):
        given["encoding"] = depth.ros_format
    return given


def _mask(mask: pb.MaskImage) -> dict[str, Any]:
    return {**_given(mask, "data"), "encoding": _MASK_ENCODINGS.get(mask.encoding, str(mask.encoding))}


def _shape(shape: pb.KnownShape) -> dict[str, Any]:
    given = _given(shape, "data", "voxel_size_m")
    if shape.camera_from_grid:
        numbers = list(shape.camera_from_grid)
        given["camera_from_grid"] = tuple(tuple(numbers[row : row + 4]) for row in range(0, len(numbers), 4))
    return given


def _material(material: pb.Material) -> dict[str, Any]:
    return _given(material, "name", "young_modulus_pa", "poisson_ratio")


def _load(load: pb.Load) -> dict[str, Any]:
    given = _given(load, "patch_radius_m")
    for name in ("force_n", "contact_m"):
        if load.HasField(name):
            given[name] = _vector(getattr(load, name))
    if load.HasField("contact_px"):
        given["contact_px"] = (load.contact_px.u, load.contact_px.v)
    return given


def _vector(vector: pb.Vector3) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


_PARTS: Mapping[str, Any] = {
    "camera": _camera,
    "depth": _depth,
    "mask": _mask,
    "up": _vector,
    "roi": lambda roi: (roi.u, roi.v, roi.width, roi.height),
    "shape": _shape,
    "material": _material,
    "outputs": lambda outputs: [name for name in _OUTPUTS if getattr(outputs, name)],
    "threshold": float,
    "reconstruction_id": str,
}


# --- replies ----------------------------------------------------------------------------------------------------


def fill_response(
    response: pb.DeformResponse, result: DeformResult, outputs: frozenset[str], request_id: str
) -> None:
    """Fill a reply in where it stands, but for `timing_ms`, which ends with the encoding itself.

    A message that is put into another is copied, megabytes and all.
    """
    response.request_id = request_id
    response.model.name = result.model_name
    response.model.version = result.model_version
    response.grid.shape.extend((GRID_SIZE,) * 3)
    response.grid.voxel_size_m = result.grid.pitch_m
    response.grid.camera_from_grid.extend(result.grid.camera_from_grid.ravel().tolist())
    response.flags.extend(sorted(result.flags))
    if result.reconstruction_id is not None:
        response.reconstruction_id = result.reconstruction_id
    for load in result.loads:
        _tell_load(response.loads.add(), load, outputs)
    if "scene" in outputs:
        response.scene = scene_glb(result)
    if "reconstruction" in outputs:
        if result.observed is not None:
            response.observed.bits = _bytes(pack_bits(result.observed))
        response.reconstruction.bits = _bytes(pack_bits(result.reconstruction))
        if "probability" in outputs:
            response.reconstruction_probability.levels = _bytes(levels(result.reconstruction_probability))


def _tell_load(answer: pb.LoadResult, load: LoadResult, outputs: frozenset[str]) -> None:
    answer.max_displacement_m = load.max_displacement_m
    answer.mean_displacement_m = load.mean_displacement_m
    answer.load_number = load.load_number
    answer.flags.extend(sorted(load.flags))
    if "deformed" in outputs:
        answer.deformed.bits = _bytes(pack_bits(load.deformed))
    if "probability" in outputs:
        answer.probability.levels = _bytes(levels(load.probability))
    if "displacement" in outputs:
        answer.displacement.float16_m = _bytes(half_precision(load))
    if "displacement_at_voxels" in outputs:
        answer.displacement_at_voxels.count = load.moved_m.shape[1]
        answer.displacement_at_voxels.float16_m = _bytes(half_precision_at_voxels(load))


def _bytes(array: np.ndarray) -> bytes:
    return np.ascontiguousarray(array).tobytes()


def list_materials(entries: Iterable[MaterialEntry]) -> pb.ListMaterialsResponse:
    """Named materials."""
    return pb.ListMaterialsResponse(
        materials=[
            pb.MaterialEntry(
                name=entry.name,
                young_modulus_pa=entry.material.young_modulus_pa,
                poisson_ratio=entry.material.poisson_ratio,
                young_modulus_min_pa=entry.young_modulus_range_pa[0],
                young_modulus_max_pa=entry.young_modulus_range_pa[1],
                description=entry.description,
                source=entry.source,
            )
            for entry in entries
        ]
    )


def get_model(manifests: Iterable[Manifest]) -> pb.GetModelResponse:
    """Manifests of models."""
    return pb.GetModelResponse(
        models=[
            pb.Model(
                name=manifest.name,
                version=manifest.version,
                kind=manifest.kind,
                threshold=manifest.threshold,
                condition_range={
                    name: pb.Range(low=low, high=high) for name, (low, high) in manifest.condition_range.items()
                },
                manifest_json=json.dumps(manifest.to_json()),
            )
            for manifest in manifests
        ]
    )


# --- errors -----------------------------------------------------------------------------------------------------


def problem_message(error: BaseException, request_id: str) -> pb.Problem:
    """The problem document of an error (`service.api.problem`) as a message."""
    document = problem_document(error, request_id)
    problem = pb.Problem(
        code=document["code"], detail=document["detail"], field=document.get("field"), request_id=request_id,
        errors=[pb.FieldProblem(**other) for other in document.get("errors", ())],
    )  # fmt: skip
    for name in ("expected", "actual"):
        if name in document:
            getattr(problem, name).CopyFrom(_value(document[name]))
    if isinstance(error, Overloaded):
        problem.retry_after_s = error.retry_after_s
    return problem


def rich_status(error: BaseException, request_id: str) -> status_pb2.Status:
    """The status of a failed call, with the problem and Google's standard details."""
    problem = problem_message(error, request_id)
    known = error.error if isinstance(error, ValidationFailed) else error
    code: StatusCode = getattr(StatusCode, status_of(known).grpc)
    status = status_pb2.Status(code=code.value[0], message=problem.detail)
    details: list[Message] = [problem, error_details_pb2.RequestInfo(request_id=request_id)]
    metadata = {
        name: _text(getattr(problem, name)) for name in ("expected", "actual") if problem.HasField(name)
    }
    details.append(error_details_pb2.ErrorInfo(reason=problem.code.upper(), domain=ERROR_DOMAIN, metadata=metadata))
    if problem.HasField("field"):
        violations = [(problem.field, problem.detail), *((other.field, other.detail) for other in problem.errors)]
        details.append(
            error_details_pb2.BadRequest(
                field_violations=[
                    error_details_pb2.BadRequest.FieldViolation(field=field, description=detail)
                    for field, detail in violations
                ]
            )
        )
    if problem.HasField("retry_after_s"):
        retry = error_details_pb2.RetryInfo()
        retry.retry_delay.FromNanoseconds(round(problem.retry_after_s * 1e9))
        details.append(retry)
    for detail in details:
        status.details.add().Pack(detail)
    return status


def _value(found: str | int | float | list[str]) -> Value:
    if isinstance(found, list):
        value = Value()
        value.list_value.extend(found)
        return value
    if isinstance(found, str):
        return Value(string_value=found)
    # As in JSON, which has no NaN.
    return Value(number_value=found) if math.isfinite(found) else Value(null_value=NULL_VALUE)


def _text(value: Value) -> str:
    match value.WhichOneof("kind"):
        case "list_value":
            return ", ".join(item.string_value for item in value.list_value.values)
        case "number_value":
            return repr(value.number_value)
        case "string_value":
            return value.string_value
    return "null"
