"""The client that robots import, for asyncio: `PhysNetClient`'s twin."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from types import TracebackType
from typing import Any, TypeVar, Unpack

from service.client.aio_stream import AsyncFrameStream, carry_by_calls, carry_by_grpc
from service.client.client import TIMEOUT_S
from service.client.frames import BACKLOG, MAX_IN_FLIGHT, FrameBook
from service.client.grpc_transport import AsyncGrpcTransport
from service.client.question import Camera, Depth, Earlier, MaterialLike, Options, Push, Question, Shape, question
from service.client.result import Result
from service.client.retry import Attempts, Retry
from service.client.transport import AsyncTransport, NamedMaterial, address
from service.core.errors import PhysNetError

T = TypeVar("T")


class AsyncPhysNetClient:
    """Asks a service, on the event loop it is made on. Arguments, results and errors are `PhysNetClient`'s."""

    def __init__(
        self,
        url: str = "http://127.0.0.1:8000",
        *,
        timeout_s: float = TIMEOUT_S,
        retry: Retry = Retry(),  # noqa: B008  # frozen
        token: str | None = None,
    ) -> None:
        self._timeout_s = timeout_s
        self._retry = retry
        self._transport = _transport(url, token)

    async def deform(
        self,
        depth: Depth | Shape | Earlier,
        camera: Camera | None = None,
        push: Push | Iterable[Push] = (),
        material: MaterialLike = "silicone",
        *,
        timeout_s: float | None = None,
        **options: Unpack[Options],
    ) -> Result:
        """The full shape of the object in a depth frame, and the shape it takes under each push."""
        return await self.ask(question(depth, camera, push, material, **options), timeout_s)

    async def ask(self, asked: Question, timeout_s: float | None = None) -> Result:
        """`deform` for a question that is complete."""
        return await self._patiently(lambda left_s: self._transport.deform(asked, left_s), timeout_s)

    async def materials(self, query: str = "", *, timeout_s: float | None = None) -> list[NamedMaterial]:
        """Named materials whose name or description holds every word of `query`."""
        return await self._patiently(lambda left_s: self._transport.materials(query, left_s), timeout_s)

    async def models(self, *, timeout_s: float | None = None) -> list[dict[str, Any]]:
        """Manifests of the models that answer."""
        return await self._patiently(self._transport.models, timeout_s)

    async def wait_until_ready(self, timeout_s: float = 60.0) -> None:
        """Wait for a service that is being started."""
        await self._patiently(self._transport.models, timeout_s, self._retry.without_end())

    def stream(
        self,
        *,
        max_in_flight: int = MAX_IN_FLIGHT,
        backlog: int = BACKLOG,
        with_skipped: bool = False,
        deadline_s: float | None = None,
    ) -> AsyncFrameStream:
        """A stream of frames in which the newest one wins, on both sides of the wire; see `PhysNetClient.stream`."""
        book = FrameBook(max_in_flight, backlog, with_skipped)
        if isinstance(self._transport, AsyncGrpcTransport):
            return AsyncFrameStream(carry_by_grpc(self._transport, self._retry, deadline_s), book)
        once = Retry(attempts=1)
        return AsyncFrameStream(carry_by_calls(lambda asked: self._patiently(
            lambda left_s: self._transport.deform(asked, left_s), deadline_s, once)), book)  # fmt: skip

    async def close(self) -> None:
        """Close the connections."""
        await self._transport.close()

    async def __aenter__(self) -> AsyncPhysNetClient:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def _patiently(
        self, ask: Callable[[float], Awaitable[T]], timeout_s: float | None, retry: Retry | None = None
    ) -> T:
        attempts = Attempts(retry or self._retry, self._timeout_s if timeout_s is None else timeout_s)
        while True:
            try:
                return await ask(attempts.left_s())
            except PhysNetError as error:
                pause_s = attempts.pause_s(error)
            await asyncio.sleep(pause_s)


def _transport(url: str, token: str | None) -> AsyncTransport:
    where = address(url)
    if where.grpc:
        return AsyncGrpcTransport(where.target, secure=where.secure, token=token)
    # Here, because beside the service httpx is an extra, and gRPC does without.
    from service.client.http_transport import AsyncHttpTransport

    return AsyncHttpTransport(where.target, token)
