"""`/v2/…`: the Open Inference Protocol over HTTP, with its binary tensor extension."""

from __future__ import annotations

import json
import time
from typing import Any

from fastapi import APIRouter, Request, Response
from google.protobuf.json_format import MessageToDict
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from pydantic_core import to_json

from service.api.body import read_body
from service.api.context import log_error
from service.api.oip_models import Inference, Models
from service.api.oip_rpc import EXTENSIONS, SERVER_NAME, config_message, statistics_message
from service.api.oip_tensors import Given, Tensor, to_bytes
from service.api.problem import problem_document, problem_headers, validation_failed
from service.core.errors import InvalidRequest
from service.settings import Settings

HEADER_LENGTH = "Inference-Header-Content-Length"
"""Bytes of JSON at the front of a body whose rest is raw tensors."""


class _Loose(BaseModel):
    # The protocol lets implementations add members.
    model_config = ConfigDict(extra="ignore")


class _Input(_Loose):
    name: str
    datatype: str
    shape: list[int]
    parameters: dict[str, Any] = Field(default_factory=dict)
    data: list[Any] | None = None


class _Output(_Loose):
    name: str
    parameters: dict[str, Any] = Field(default_factory=dict)


class _Infer(_Loose):
    id: str = ""
    parameters: dict[str, Any] = Field(default_factory=dict)
    inputs: list[_Input]
    outputs: list[_Output] = Field(default_factory=list)


def create_oip(models: Models, settings: Settings, version: str) -> APIRouter:
    """The routes of the protocol. They describe themselves; the OpenAPI document is that of our own API."""
    router = APIRouter(prefix="/v2", include_in_schema=False)

    @router.get("")
    async def server() -> dict[str, Any]:
        return {"name": SERVER_NAME, "version": version, "extensions": EXTENSIONS}

    @router.get("/health/live")
    async def live() -> dict[str, bool]:
        return {"live": True}

    @router.get("/health/ready")
    async def ready() -> Response:
        return _json({"ready": models.ready}, 200 if models.ready else 503)

    @router.get("/models/stats")
    async def all_statistics(request: Request) -> Response:
        return _json(_statistics(models, list(models.all())))

    for path in ("/models/{name}", "/models/{name}/versions/{version}"):
        _add_model(router, path, models, settings)
    return router


def _add_model(router: APIRouter, path: str, models: Models, settings: Settings) -> None:
    @router.get(path)
    async def metadata(request: Request, name: str, version: str = "") -> Response:
        try:
            model = models.find(name, version)
        except Exception as error:
            return _failed(request, error)
        inputs, outputs = ([_metadata(tensor) for tensor in tensors] for tensors in (model.inputs, model.outputs))
        known = {"name": model.name, "versions": [model.version], "platform": model.platform}
        return _json({**known, "inputs": inputs, "outputs": outputs})

    @router.get(f"{path}/ready")
    async def ready(request: Request, name: str, version: str = "") -> Response:
        try:
            models.find(name, version)
        except Exception as error:
            return _failed(request, error)
        return _json({"name": name, "ready": True})

    @router.get(f"{path}/config")
    async def config(request: Request, name: str, version: str = "") -> Response:
        try:
            found = config_message(models.find(name, version))
        except Exception as error:
            return _failed(request, error)
        return _json(_document(found))

    @router.get(f"{path}/stats")
    async def statistics(request: Request, name: str, version: str = "") -> Response:
        try:
            return _json(_statistics(models, [models.find(name, version).name]))
        except Exception as error:
            return _failed(request, error)

    @router.post(f"{path}/infer")
    async def infer(request: Request, name: str, version: str = "") -> Response:
        deadline = time.monotonic() + settings.request_deadline_s
        try:
            header, rest = _split(
                await read_body(request, settings.max_body_bytes, deadline), request.headers.get(HEADER_LENGTH)
            )
            try:
                asked = _Infer.model_validate_json(header)
            except ValidationError as failure:
                raise validation_failed(failure) from None
            wanted = [output.name for output in asked.outputs]
            found = await models.infer(name, version, _given(asked, rest), wanted, deadline)
        except Exception as error:
            return _failed(request, error)
        return _answer(found, asked)


def _split(body: bytes, header_length: str | None) -> tuple[bytes, memoryview]:
    if header_length is None:
        return body, memoryview(b"")
    if not header_length.isdecimal() or int(header_length) > len(body):
        raise InvalidRequest(
            f"{HEADER_LENGTH} must be the number of bytes of JSON in the body.",
            field=HEADER_LENGTH, expected=f"at most {len(body)}", actual=header_length[:40],
        )  # fmt: skip
    length = int(header_length)
    return body[:length], memoryview(body)[length:]


def _given(asked: _Infer, rest: memoryview) -> list[Given]:
    given = []
    for one in asked.inputs:
        size = one.parameters.get("binary_data_size")
        data: memoryview | list[Any]
        if size is None:
            data = [] if one.data is None else one.data
        elif isinstance(size, int) and 0 <= size <= len(rest):
            data, rest = rest[:size], rest[size:]
        else:
            raise InvalidRequest(
                f"The body does not hold the binary data of `{one.name[:80]}`.",
                field=f"inputs[{one.name[:80]}].parameters.binary_data_size", expected=f"at most {len(rest)}",
                actual=str(size)[:40],
            )  # fmt: skip
        given.append(Given(one.name, one.datatype, one.shape, data))
    if len(rest):
        raise InvalidRequest(
            "The body is longer than its header and tensors.", field=HEADER_LENGTH, expected=0, actual=len(rest)
        )
    return given


def _answer(found: Inference, asked: _Infer) -> Response:
    binary_by_default = bool(asked.parameters.get("binary_data_output", False))
    binary = {output.name: bool(output.parameters.get("binary_data", binary_by_default)) for output in asked.outputs}
    outputs, chunks = [], []
    for tensor, array in found.outputs:
        output: dict[str, Any] = {"name": tensor.name, "datatype": tensor.datatype, "shape": list(array.shape)}
        if binary.get(tensor.name, binary_by_default):
            chunks.append(to_bytes(array, tensor.datatype))
            output["parameters"] = {"binary_data_size": len(chunks[-1])}
        else:
            output["data"] = array.ravel().tolist()
        outputs.append(output)
    document: dict[str, Any] = {"model_name": found.model.name, "model_version": found.model.version}
    if asked.id:
        document["id"] = asked.id
    header = to_json({**document, "outputs": outputs}, inf_nan_mode="null")
    if not chunks:
        return Response(header, media_type="application/json")
    return Response(
        b"".join([header, *chunks]), headers={HEADER_LENGTH: str(len(header))}, media_type="application/octet-stream"
    )


def _failed(request: Request, error: Exception) -> Response:
    """The protocol's `error` beside the members of our own problem documents."""
    request_id: str = request.state.request_id
    request.state.code = log_error(error, request_id)
    problem = problem_document(error, request_id)
    return _json({"error": problem["detail"], **problem}, problem["status"], problem_headers(error))


def _json(document: Any, status: int = 200, headers: dict[str, str] | None = None) -> Response:
    return Response(to_json(document, inf_nan_mode="null"), status, headers, "application/json")


def _metadata(tensor: Tensor) -> dict[str, Any]:
    return {"name": tensor.name, "datatype": tensor.datatype, "shape": tensor.dims}


def _statistics(models: Models, names: list[str]) -> dict[str, Any]:
    return {"model_stats": [_document(statistics_message(models.find(name))) for name in names]}


def _document(found: Any) -> Any:
    document = MessageToDict(found, preserving_proto_field_name=True)
    # JSON of protobuf writes 64-bit numbers as strings; the protocol's REST wants numbers.
    return json.loads(json.dumps(document), object_hook=_numbers)


def _numbers(members: dict[str, Any]) -> dict[str, Any]:
    counts = ("count", "ns", "last_inference", "inference_count", "execution_count")
    converted: dict[str, Any] = {key: int(value) if key in counts else value for key, value in members.items()}
    if "dims" in converted:
        converted["dims"] = [int(size) for size in converted["dims"]]
    return converted
