"""Request bodies: read no further than the limit and the deadline, and taken apart where they are multipart."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import AsyncGenerator

from starlette.datastructures import FormData, UploadFile
from starlette.formparsers import MultiPartException, MultiPartParser
from starlette.requests import Request

from service.core.errors import DeadlineExceeded, InvalidRequest, PayloadTooLarge

DRAIN_S = 2.0
"""How long what a client still sends after a refusal is read and thrown away.

A connection closed with unread data is reset, and a reset takes the reply away before the client has read it.
"""

FILE_PARTS = ("depth", "mask")


class _InMemoryParser(MultiPartParser):
    # The body is bounded already, and a frame that goes through a file costs more than its decoding.
    spool_max_size = sys.maxsize


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
    stream = _limited(request, max_bytes, deadline)
    parser = _InMemoryParser(request.headers, stream, max_files=8, max_fields=8, max_part_size=max_bytes)
    try:
        form = await parser.parse()
    except MultiPartException as error:
        raise InvalidRequest(f"The body is not multipart/form-data: {error.message}", expected="parts") from None
    try:
        parts = await _parts(form)
    finally:
        await form.close()
    if "request" not in parts:
        raise InvalidRequest("The part `request` is missing.", field="request", expected="a part with JSON")
    return parts.pop("request"), parts


async def _parts(form: FormData) -> dict[str, bytes]:
    parts: dict[str, bytes] = {}
    for name, value in form.multi_items():
        if name not in ("request", *FILE_PARTS):
            short = name[:80]
            raise InvalidRequest(f"`{short}` is not a part of this request.", field=short, expected="no such part")
        if name in parts:
            raise InvalidRequest(f"The part `{name}` is there twice.", field=name, expected="one part")
        parts[name] = await value.read() if isinstance(value, UploadFile) else value.encode()
    return parts


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
