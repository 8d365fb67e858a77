"""Request bodies: read no further than the limit and the deadline, and taken apart where they are multipart."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncGenerator

from starlette.requests import Request

from service.api.multipart import parts_of
from service.core.errors import DeadlineExceeded, InvalidRequest, PayloadTooLarge

DRAIN_S = 2.0
"""How long what a client still sends after a refusal is read and thrown away.

A connection closed with unread data is reset, and a reset takes the reply away before the client has read it.
"""

FILE_PARTS = ("depth", "mask")


async def read_body(request: Request, max_bytes: int, deadline: float) -> bytes:
    """The whole body.

    Raises:
        PayloadTooLarge: It is longer than `max_bytes`; noticed while it arrives, not after.
        DeadlineExceeded: It did not arrive by `deadline` (`time.monotonic()`).
    """
    return b"".join([chunk async for chunk in _limited(request, max_bytes, deadline)])


async def read_multipart(request: Request, max_bytes: int, deadline: float) -> tuple[bytes, dict[str, bytes]]:
    """The `request` part and the file parts of a multipart body.

    Raises:
        InvalidRequest: The body is not multipart, lacks `request`, or has parts of other names.
        PayloadTooLarge: See `read_body`.
        DeadlineExceeded: See `read_body`.
    """
    body = await read_body(request, max_bytes, deadline)
    parts: dict[str, bytes] = {}
    for name, content in parts_of(body, request.headers.get("content-type", "")):
        if name not in ("request", *FILE_PARTS):
            short = name[:80]
            raise InvalidRequest(f"`{short}` is not a part of this request.", field=short, expected="no such part")
        if name in parts:
            raise InvalidRequest(f"The part `{name}` is there twice.", field=name, expected="one part")
        parts[name] = content
    if "request" not in parts:
        raise InvalidRequest("The part `request` is missing.", field="request", expected="a part with JSON")
    return parts.pop("request"), parts


async def _limited(request: Request, max_bytes: int, deadline: float) -> AsyncGenerator[bytes, None]:
    declared = request.headers.get("content-length", "")
    too_large = declared.isdecimal() and int(declared) > max_bytes
    received = 0
    stream = request.stream()
    try:
        async with asyncio.timeout(deadline - time.monotonic()):
            while not too_large:
                chunk = await anext(stream, None)
                if chunk is None:
                    return
                received += len(chunk)
                too_large = received > max_bytes
                if not too_large:
                    yield chunk
    except TimeoutError:
        raise DeadlineExceeded(
            f"The request did not arrive within its deadline; {received} bytes did.", field=None
        ) from None
    await _drain(stream)
    raise PayloadTooLarge(
        "The request is larger than this service accepts.",
        expected=f"at most {max_bytes} bytes",
        actual=int(declared) if declared.isdecimal() else received,
    )


async def _drain(stream: AsyncGenerator[bytes, None]) -> None:
    try:
        async with asyncio.timeout(DRAIN_S):
            async for _ in stream:
                pass
    except TimeoutError:
        pass
