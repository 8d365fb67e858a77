"""HTTP by httpx: connections are kept and used again."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from typing import Any

from service.client import http_wire
from service.client.errors import ServiceUnreachable, timed_out
from service.client.question import Question
from service.client.result import Result
from service.client.transport import NamedMaterial, named_materials
from service.core.errors import InvalidRequest, PhysNetError

try:
    import httpx
except ModuleNotFoundError as missing:
    raise ModuleNotFoundError(
        "HTTP needs httpx: pip install 'physnet[client]'; grpc://HOST:PORT needs nothing more"
    ) from missing

_LIMITS = httpx.Limits(max_keepalive_connections=8, keepalive_expiry=60.0)
"""The service keeps a silent connection for 75 s: ours is given up before, so that none breaks under a request."""


class HttpTransport:
    """Blocking."""

    def __init__(self, url: str, token: str | None) -> None:
        self._small = True  # until a service is found not to know of it
        self._http = httpx.Client(base_url=url, headers=_headers(token), limits=_LIMITS, verify=_tls(url))

    def deform(self, question: Question, timeout_s: float) -> Result:
        """POST /v1/deform."""
        ends = time.monotonic() + timeout_s
        try:
            return self._deform(question, timeout_s)
        except InvalidRequest as error:
            if not http_wire.knows_only_grids(error):
                raise
        self._small = False
        return self._deform(question, ends - time.monotonic())

    def _deform(self, question: Question, timeout_s: float) -> Result:
        headers, content = http_wire.encode(question, self._small)
        headers |= _deadline(timeout_s)
        return http_wire.result(self._ask("POST", "/v1/deform", timeout_s, content=content, headers=headers))

    def materials(self, query: str, timeout_s: float) -> list[NamedMaterial]:
        """GET /v1/materials."""
        return named_materials(self._ask("GET", "/v1/materials", timeout_s, params={"q": query})["materials"])

    def models(self, timeout_s: float) -> list[dict[str, Any]]:
        """GET /v1/models."""
        return list(self._ask("GET", "/v1/models", timeout_s)["models"])

    def close(self) -> None:
        """Close the connections."""
        self._http.close()

    def _ask(self, method: str, path: str, timeout_s: float, **more: Any) -> Any:
        try:
            reply = self._http.request(method, path, timeout=timeout_s, **more)
        except (httpx.HTTPError, RuntimeError) as error:  # the latter where the client is closed
            raise _failure(error, timeout_s, self._http.base_url) from error
        return http_wire.decode(reply.status_code, reply.headers, reply.content)


class AsyncHttpTransport:
    """For asyncio."""

    def __init__(self, url: str, token: str | None) -> None:
        self._small = True
        self._http = httpx.AsyncClient(base_url=url, headers=_headers(token), limits=_LIMITS, verify=_tls(url))

    async def deform(self, question: Question, timeout_s: float) -> Result:
        """POST /v1/deform."""
        ends = time.monotonic() + timeout_s
        try:
            return await self._deform(question, timeout_s)
        except InvalidRequest as error:
            if not http_wire.knows_only_grids(error):
                raise
        self._small = False
        return await self._deform(question, ends - time.monotonic())

    async def _deform(self, question: Question, timeout_s: float) -> Result:
        headers, content = http_wire.encode(question, self._small)
        headers |= _deadline(timeout_s)
        return http_wire.result(await self._ask("POST", "/v1/deform", timeout_s, content=content, headers=headers))

    async def materials(self, query: str, timeout_s: float) -> list[NamedMaterial]:
        """GET /v1/materials."""
        return named_materials((await self._ask("GET", "/v1/materials", timeout_s, params={"q": query}))["materials"])

    async def models(self, timeout_s: float) -> list[dict[str, Any]]:
        """GET /v1/models."""
        return list((await self._ask("GET", "/v1/models", timeout_s))["models"])

    async def close(self) -> None:
        """Close the connections."""
        await self._http.aclose()

    async def _ask(self, method: str, path: str, timeout_s: float, **more: Any) -> Any:
        try:
            # httpx bounds each read and write; this bounds them all.
            async with asyncio.timeout(timeout_s):
                reply = await self._http.request(method, path, timeout=timeout_s, **more)
        except TimeoutError as error:
            raise timed_out(timeout_s) from error
        except (httpx.HTTPError, RuntimeError) as error:  # the latter where the client is closed
            raise _failure(error, timeout_s, self._http.base_url) from error
        return http_wire.decode(reply.status_code, reply.headers, reply.content)


def _headers(token: str | None) -> Mapping[str, str]:
    return {"Accept": "application/json"} | ({"Authorization": f"Bearer {token}"} if token else {})


def _tls(url: str) -> bool:
    # Reading every authority's certificate takes longer than most requests; plain HTTP checks none.
    return url.startswith("https:")


def _deadline(timeout_s: float) -> dict[str, str]:
    # What nobody waits for any more need not be computed.
    return {"X-Deadline-Ms": f"{1e3 * timeout_s:.3f}"}


def _failure(error: Exception, timeout_s: float, url: httpx.URL) -> PhysNetError:
    if isinstance(error, httpx.TimeoutException):
        return timed_out(timeout_s)
    where = str(url).rstrip("/")
    return ServiceUnreachable(f"The service at {where} cannot be reached: {error or type(error).__name__}")

