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

from service.api.metrics import Metrics
from service.api.problem import MEDIA_TYPE, ValidationFailed, problem_bytes, problem_document, problem_headers
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

    def __init__(self, app: ASGIApp, metrics: Metrics, token: str | None) -> None:
        self._app = app
        self._metrics = metrics
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
        status = 0

        async def send_with_id(message: Message) -> None:
            nonlocal status
            if message["type"] == "http.response.start":
                status = message["status"]
                MutableHeaders(scope=message)["X-Request-Id"] = request_id
            await send(message)

        code = "ok"
        try:
            if scope["path"].startswith(("/v1/", "/v2/models")):
                check_token(headers.get("authorization", ""), self._token)
            await self._app(scope, receive, send_with_id)
            code = state.get("code", "ok" if status < 400 else "internal")
        except ClientDisconnect:
            code = "cancelled"
        except Exception as error:
            code = log_error(error, request_id)
            if status == 0:
                await problem_response(error, request_id)(scope, receive, send_with_id)
        finally:
            route = getattr(scope.get("route"), "path", "none")
            self._metrics.request("http", route, code, time.perf_counter() - started)


def log_error(error: Exception, request_id: str) -> str:
    """Log an error that ended a request; returns the code it is counted under."""
    known = error.error if isinstance(error, ValidationFailed) else error
    if isinstance(known, PhysNetError):
        log.info("%s: %s request=%s field=%s", known.code, known.message, request_id, known.field)
        return known.code
    log.error("unexpected error request=%s", request_id, exc_info=error)
    return PhysNetError.code
