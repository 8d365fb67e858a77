"""The HTTP wire: routes that read, translate, ask the handler, and translate back."""

from __future__ import annotations

import asyncio
import math
import time
from collections.abc import Mapping
from typing import Annotated, Any, TypeVar

from fastapi import FastAPI, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import ValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from service.api import convert, openapi, replies
from service.api.body import read_body, read_multipart
from service.api.context import RequestContext
from service.api.handler import Handler
from service.api.live import create_live
from service.api.metrics import CONTENT_TYPE_LATEST
from service.api.oip_models import Models
from service.api.oip_rest import create_oip
from service.api.problem import MEDIA_TYPE, document, field_path, problem_bytes
from service.api.scene import scene_glb
from service.api.schemas import MaterialReply, MaterialsReply
from service.api.site import add_site
from service.api.status import meanings
from service.core.errors import InvalidRequest, Overloaded
from service.core.materials import search_materials
from service.core.messages import DeformResult
from service.scheduler import Answer
from service.settings import Settings

NPZ = "application/x-npz"
GLB = "model/gltf-binary"
JSON = "application/json"

DEADLINE_HEADER = "X-Deadline-Ms"
"""Milliseconds from a request's arrival after which its answer is of no use to the robot."""

T = TypeVar("T")


def create_http(handler: Handler, settings: Settings, models: Models | None = None) -> FastAPI:
    """The ASGI application; `models` are those of the Open Inference Protocol where it is served on two wires."""
    app = FastAPI(
        title="PhysNet",
        version=openapi.API_VERSION,
        description=openapi.DESCRIPTION,
        docs_url=None,
        redoc_url=None,
        responses=openapi.PROBLEMS,
    )
    token = settings.token.get_secret_value() if settings.token else None
    app.add_middleware(RequestContext, handler=handler, token=token)
    app.add_exception_handler(HTTPException, _http_exception)
    app.add_exception_handler(RequestValidationError, _query_exception)
    _add_deform(app, handler, settings)
    _add_tables(app, handler)
    _add_operations(app, handler)
    app.include_router(
        create_oip(models or Models(handler, settings.max_loads), settings, openapi.API_VERSION)
    )
    app.include_router(create_live(handler, settings))
    add_site(app)
    app.openapi = lambda: openapi.document(app, secured=token is not None)  # type: ignore[method-assign]
    return app


def _add_deform(app: FastAPI, handler: Handler, settings: Settings) -> None:
    @app.post("/v1/deform", tags=["deform"], summary="One frame in, full and deformed shapes out", **openapi.DEFORM)
    async def deform(request: Request) -> Response:
        arrived = time.monotonic()
        deadline = arrived + _allowed_s(request, settings.request_deadline_s)
        media_type = _accepted(request.headers.get("accept", "*/*"))
        content_type = request.headers.get("content-type", JSON).partition(";")[0].strip().lower()
        files: Mapping[str, bytes] | None = None
        if content_type == "multipart/form-data":
            data, files = await read_multipart(request, settings.max_body_bytes, deadline)
        elif content_type == JSON or content_type.endswith("+json"):
            data = await read_body(request, settings.max_body_bytes, deadline)
        else:
            raise InvalidRequest(
                "The request must be JSON or multipart.",
                field="Content-Type",
                expected=[JSON, "multipart/form-data"],
                actual=content_type[:80],
            )
        received = time.perf_counter()
        question = convert.deform_request(convert.parse_body(data), settings.max_loads, files)
        parsed = time.perf_counter()
        answer = await _unless_disconnected(request, handler.deform(question, deadline))
        timing_ms = {"parse": 1e3 * (parsed - received)}
        request_id: str = request.state.request_id
        if replies.is_heavy(question) or media_type != JSON:
            encoded = await asyncio.to_thread(
                _encoded, answer, question.outputs, request_id, media_type, timing_ms, received
            )
        else:
            encoded = _encoded(answer, question.outputs, request_id, media_type, timing_ms, received)
        handler.answered(timing_ms, request.state.span)
        return Response(encoded, media_type=media_type)


def _encoded(
    answer: Answer[DeformResult],
    outputs: frozenset[str],
    request_id: str,
    media_type: str,
    timing_ms: dict[str, float],
    received: float,
) -> bytes:
    """The reply's bytes; completes `timing_ms`."""
    began = time.perf_counter()
    timing_ms["queue"] = 1e3 * answer.queued_s
    timing_ms |= {stage: ms for stage, ms in answer.result.timing_ms.items() if stage != "total"}

    def stop() -> None:
        now = time.perf_counter()
        timing_ms["encode"] = 1e3 * (now - began)
        timing_ms["total"] = 1e3 * (now - received)

    if media_type == GLB:
        scene = scene_glb(answer.result)
        stop()
        return scene
    if media_type == NPZ:
        # The archive's timings are those up to its writing: it cannot be timed before it is closed.
        stop()
        return replies.reply_npz(answer.result, outputs, request_id, timing_ms)
    document = replies.reply_document(answer.result, outputs, request_id)
    stop()
    return replies.reply_json(document, timing_ms)


async def _unless_disconnected(request: Request, answer: Any) -> Answer[DeformResult]:
    """The answer, unless the client goes away first: then its place in the queue is given up."""
    asked = asyncio.ensure_future(answer)
    gone = asyncio.ensure_future(request.receive())
    try:
        await asyncio.wait({asked, gone}, return_when=asyncio.FIRST_COMPLETED)
        if not asked.done():
            raise ClientDisconnect
        result: Answer[DeformResult] = asked.result()
        return result
    finally:
        gone.cancel()
        asked.cancel()


def _allowed_s(request: Request, longest_s: float) -> float:
    given = request.headers.get(DEADLINE_HEADER)
    if given is None:
        return longest_s
    try:
        milliseconds = float(given)
    except ValueError:
        milliseconds = math.nan
    if not (math.isfinite(milliseconds) and milliseconds > 0.0):
        raise InvalidRequest(
            f"{DEADLINE_HEADER} must be a positive number of milliseconds.",
            field=DEADLINE_HEADER,
            expected="> 0",
            actual=given[:80],
        )
    return min(longest_s, 1e-3 * milliseconds)


def _accepted(accept: str) -> str:
    """The media type of the reply: the client's most wanted one that we write, JSON among equals."""
    wanted: dict[str, float] = {}
    for item in accept.split(","):
        name, *parameters = (part.strip().lower() for part in item.split(";"))
        quality = 1.0
        for parameter in parameters:
            if parameter.startswith("q="):
                try:
                    quality = float(parameter[2:])
                except ValueError:
                    quality = 0.0
        wanted[name] = quality
    anything = max(wanted.get("*/*", 0.0), wanted.get("application/*", 0.0))
    offers = {JSON: wanted.get(JSON, anything), NPZ: wanted.get(NPZ, 0.0), GLB: wanted.get(GLB, 0.0)}
    best = max(offers, key=lambda name: offers[name])
    if offers[best] <= 0.0:
        raise InvalidRequest(
            "The reply can be JSON, a NumPy archive or a glTF scene.",
            field="Accept", expected=[JSON, NPZ, GLB], actual=accept[:80],
        )  # fmt: skip
    return best


def _add_tables(app: FastAPI, handler: Handler) -> None:
    @app.get("/v1/materials", tags=["tables"], summary="Named materials with sources")
    async def materials(
        q: Annotated[str, Query(max_length=100, description="Words that name or description must hold.")] = "",
    ) -> MaterialsReply:
        found = search_materials(q)
        return MaterialsReply(
            materials=[
                MaterialReply(
                    name=entry.name,
                    young_modulus_pa=entry.material.young_modulus_pa,
                    poisson_ratio=entry.material.poisson_ratio,
                    young_modulus_range_pa=entry.young_modulus_range_pa,
                    description=entry.description,
                    source=entry.source,
                )
                for entry in found
            ]
        )

    @app.get("/v1/models", tags=["tables"], summary="Manifests of the models that answer")
    async def models() -> JSONResponse:
        if not handler.ready:
            raise Overloaded("The models are still being loaded; try again in a second.", retry_after_s=1.0)
        return JSONResponse({"models": [manifest.to_json() for manifest in handler.manifests]})


def _add_operations(app: FastAPI, handler: Handler) -> None:
    @app.get("/healthz", tags=["operation"], summary="The process is alive")
    async def healthz() -> dict[str, str]:
        return {"status": "alive"}

    @app.get("/readyz", tags=["operation"], summary="The models are loaded and warmed up")
    async def readyz() -> dict[str, str]:
        if not handler.ready:
            raise Overloaded("The models are not loaded and warmed up yet.", retry_after_s=1.0)
        return {"status": "ready"}

    @app.get("/metrics", tags=["operation"], summary="Prometheus metrics", response_class=Response)
    async def metrics() -> Response:
        return Response(handler.metrics.exposition(), media_type=CONTENT_TYPE_LATEST)

    @app.get("/problems/{code}", tags=["operation"], summary="What an error code means")
    async def problem(code: str) -> dict[str, Any]:
        if code not in (known := meanings()):
            raise HTTPException(404, f"No error has the code {code[:80]!r}.")
        status = known[code]
        return {"code": code, "http": status.http, "grpc": status.grpc, "meaning": status.meaning}


async def _http_exception(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    codes = {404: "not_found", 405: "method_not_allowed"}
    code = codes.get(error.status_code, "invalid_request" if error.status_code < 500 else "internal")
    detail = f"{request.method} {request.url.path[:200]}: {error.detail}"
    return _problem(request, code, error.status_code, detail, headers=dict(error.headers or {}))


async def _query_exception(request: Request, error: Exception) -> Response:
    assert isinstance(error, (RequestValidationError, ValidationError))
    first = error.errors()[0]
    return _problem(request, "invalid_request", 400, f"{first['msg']}.", field=field_path(first["loc"][1:]))


def _problem(
    request: Request, code: str, status: int, detail: str, headers: dict[str, str] | None = None, **more: object
) -> Response:
    request.state.code = code
    body = problem_bytes(document(code, status, detail, request.state.request_id, **more))
    return Response(body, status, headers, MEDIA_TYPE)
