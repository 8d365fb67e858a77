"""What surrounds every HTTP request: its id, the token, errors as problem documents, and the counting."""

from __future__ import annotations

import logging
import re
import secrets
import time
import uuid

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect
from starlette.responses import Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from service.api.handler import Handler
from service.api.problem import MEDIA_TYPE, ValidationFailed, problem_bytes, problem_document, problem_headers
from service.api.tracing import NO_SPAN, NO_TRACER, Span
from service.core.errors import PhysNetError, Unauthenticated

log = logging.getLogger(__name__)

# A client's own id goes into logs and headers, so it must not bring line breaks or a flood with it.
_USABLE_ID = re.compile(r"[A-Za-z0-9._:/+=-]{1,128}")


def request_id_of(given: str) -> str:
    """The client's own id where it is usable, else one made up."""
    return given if _USABLE_ID.fullmatch(given) else uuid.uuid4().hex


def check_token(authorization: str, token: str | None) -> None:
    """Raises `Unauthenticated` where a token is asked for and `authorization` does not hold it."""
    if token is None:
        return
    scheme, _, given = authorization.partition(" ")
    # Compared as bytes: a header may hold any of latin-1, which compare_digest takes only as bytes.
    if scheme.lower() != "bearer" or not secrets.compare_digest(given.strip().encode(), token.encode()):
        raise Unauthenticated("This service wants `Authorization: Bearer <token>`.", field="Authorization")


def problem_response(error: BaseException, request_id: str) -> Response:
    """The reply to a request that failed."""
    problem = problem_document(error, request_id)
    return Response(problem_bytes(problem), problem["status"], problem_headers(error), MEDIA_TYPE)


class RequestContext:
    """ASGI middleware. A plain class: starlette's BaseHTTPMiddleware would hide a client's disconnection."""

    def __init__(self, app: ASGIApp, handler: Handler, token: str | None) -> None:
        self._app = app
        self._handler = handler
        self._token = token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        started = time.perf_counter()
        headers = Headers(scope=scope)
        request_id = request_id_of(headers.get("x-request-id", ""))
        state = scope.setdefault("state", {})
        state["request_id"] = request_id
        ours = scope["path"].startswith(("/v1/", "/v2/models"))
        tracer = self._handler.tracer if ours else NO_TRACER
        attributes = {"http.request.method": scope["method"], "physnet.request_id": request_id}
        state["span"] = span = tracer.begin(scope["method"], headers, attributes)
        status = 0

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)["X-Request-Id"] = request_id
            await send(message)

        code = "ok"
        try:
            if ours:
                check_token(headers.get("authorization", ""), self._token)
            await self._app(scope, receive, send_with_id)
            code = state.get("code", "ok" if status < 400 else "internal")
        except ClientDisconnect:
            code = "cancelled"
        except Exception as error:
            code = log_error(error, request_id, span)
            if status == 0:
                await problem_response(error, request_id)(scope, receive, send_with_id)
        finally:
            route = getattr(scope.get("route"), "path", "none")
            elapsed_s = time.perf_counter() - started
            self._handler.metrics.request("http", route, code, elapsed_s)
            span.end(code, f"{scope['method']} {route}")
            log_done("http", route, code, elapsed_s, request_id, span)


def log_error(error: Exception, request_id: str, span: Span = NO_SPAN) -> str:
    """Log an error that ended a request; returns the code it is counted under."""
    known = error.error if isinstance(error, ValidationFailed) else error
    extra = {"request_id": request_id, "trace_id": span.trace_id}
    if isinstance(known, PhysNetError):
        extra |= {"code": known.code, "field": known.field or ""}
        log.info("%s: %s request=%s field=%s", known.code, known.message, request_id, known.field, extra=extra)
        return known.code
    extra["code"] = PhysNetError.code
    log.error("unexpected error request=%s", request_id, exc_info=error, extra=extra)
    return PhysNetError.code


def log_done(wire: str, route: str, code: str, elapsed_s: float, request_id: str, span: Span = NO_SPAN) -> None:
    """Log the end of a request, at the level of a robot's 30 a second."""
    if log.isEnabledFor(logging.DEBUG):
        duration_ms = round(1e3 * elapsed_s, 3)
        extra = {
            "wire": wire, "route": route, "code": code, "duration_ms": duration_ms, "request_id": request_id,
            "trace_id": span.trace_id,
        }  # fmt: skip
        log.debug("%s %s %s %.1f ms request=%s", wire, route, code, duration_ms, request_id, extra=extra)
