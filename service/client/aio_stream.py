"""Streams of frames for asyncio: the twin of `service.client.stream`, on one event loop and without threads."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Awaitable, Callable, Iterable
from types import TracebackType
from typing import Unpack

import grpc

from service.api.generated import deformation_pb2 as pb
from service.client import grpc_wire
from service.client.errors import ServiceUnreachable
from service.client.frames import Answer, Counts, Frame, FrameBook
from service.client.grpc_transport import AsyncGrpcTransport
from service.client.question import Camera, Depth, Earlier, MaterialLike, Options, Push, Question, Shape, question
from service.client.result import Result
from service.client.retry import Retry
from service.core.errors import PhysNetError


class AsyncFrameStream:
    """A stream of frames. `send` never waits; iterate for the answers.

    An asynchronous context manager: leaving it waits for the answers that are still due, unless by an exception.

    Args:
        carry: Takes frames and settles them until there are no more, as a task.
        book: Of the frames.
    """

    def __init__(self, carry: Callable[[AsyncFrameStream], Awaitable[None]], book: FrameBook) -> None:
        self._book = book
        self._changed = asyncio.Condition()
        self._closed = False
        self._ended_by: PhysNetError | None = None
        self._era = 0
        self._task = asyncio.ensure_future(self._run(carry))
        self._telling: set[asyncio.Task[None]] = set()

    # --- the robot's side

    def send(
        self,
        depth: Depth | Shape | Earlier,
        camera: Camera | None = None,
        push: Push | Iterable[Push] = (),
        material: MaterialLike = "silicone",
        *,
        frame_id: int | None = None,
        **options: Unpack[Options],
    ) -> int:
        """Hand a frame in; a frame that still waits to be sent is overtaken by it. See `FrameStream.send`."""
        return self.ask(question(depth, camera, push, material, **options), frame_id)

    def ask(self, asked: Question, frame_id: int | None = None) -> int:
        """`send` for a question that is complete."""
        if self._closed or self._task.done():
            raise ServiceUnreachable("The stream is closed.")
        number = self._book.add(asked, frame_id).frame_id
        self._tell()
        return number

    async def __aiter__(self) -> AsyncIterator[Answer]:
        """Answers as they come, until the stream is closed and the last is there; raises where it broke for good."""
        while (answer := await self.next()) is not None:
            yield answer

    async def next(self) -> Answer | None:
        """The next answer; None when the stream has ended."""
        async with self._changed:
            await self._changed.wait_for(lambda: self._book.answers or self._over)
            if self._book.answers:
                return self._book.answers.popleft()
        if self._ended_by is not None:
            raise self._ended_by
        return None

    def counts(self) -> Counts:
        """What became of the frames so far."""
        return Counts(**vars(self._book.counts))

    async def close(self, *, drain: bool = True) -> None:
        """Send no more frames. With `drain` the answers still due are waited for, else given up."""
        self._closed = True
        self._tell()
        if not drain:
            self._task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await asyncio.shield(self._task) if drain else await self._task

    async def __aenter__(self) -> AsyncFrameStream:
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close(drain=kind is None)

    @property
    def _over(self) -> bool:
        return self._task.done() or (self._closed and self._book.idle)

    # --- the wire's side

    async def take(self, era: int) -> Frame | None:
        """The newest frame, once there is one and room for it; None when the stream or this era of it is over."""
        async with self._changed:
            while era == self._era:
                if (frame := self._book.next()) is not None:
                    return frame
                if self._closed and not self._book.waits:
                    return None
                await self._changed.wait()
            return None

    async def settle(self, answer: Answer) -> None:
        """What became of a frame that was taken."""
        self._book.done(answer)
        await self._notify()

    async def begin_era(self, error: PhysNetError | None = None) -> int:
        """A new connection; what was under way on the one before is lost by `error`."""
        if error is not None:
            self._book.lose(error)
        self._era += 1
        await self._notify()
        return self._era

    @property
    def over(self) -> bool:
        """Whether no frame is to come and none is due."""
        return self._closed and self._book.idle

    async def _run(self, carry: Callable[[AsyncFrameStream], Awaitable[None]]) -> None:
        error: PhysNetError = ServiceUnreachable("The stream was closed.")
        try:
            await carry(self)
        except PhysNetError as failed:
            self._ended_by = error = failed
        finally:
            self._book.lose(error, waiting_too=True)
            self._task.add_done_callback(lambda _: self._tell())

    def _tell(self) -> None:
        task = asyncio.ensure_future(self._notify())
        self._telling.add(task)
        task.add_done_callback(self._telling.discard)

    async def _notify(self) -> None:
        async with self._changed:
            self._changed.notify_all()


def carry_by_calls(ask: Callable[[Question], Awaitable[Result]]) -> Callable[[AsyncFrameStream], Awaitable[None]]:
    """Streams over a wire that has none: one question after the other, always about the newest frame."""

    async def carry(stream: AsyncFrameStream) -> None:
        era = await stream.begin_era()
        while (frame := await stream.take(era)) is not None:
            try:
                answer = Answer(frame.frame_id, result=await ask(frame.question))
            except PhysNetError as error:
                answer = Answer(frame.frame_id, error=error)
            await stream.settle(answer)

    return carry


def carry_by_grpc(
    transport: AsyncGrpcTransport, retry: Retry, deadline_s: float | None
) -> Callable[[AsyncFrameStream], Awaitable[None]]:
    """One gRPC stream, opened again where it breaks; `deadline_s` is each frame's, in the service."""

    async def messages(stream: AsyncFrameStream, era: int) -> AsyncIterator[pb.DeformStreamRequest]:
        while (frame := await stream.take(era)) is not None:
            yield grpc_wire.stream_request(frame, deadline_s)

    async def carry(stream: AsyncFrameStream) -> None:
        tried = 0
        error: PhysNetError | None = None
        while not stream.over:
            call = transport.stream(messages(stream, await stream.begin_era(error)))
            try:
                async for response in call:
                    tried = 0
                    await stream.settle(grpc_wire.stream_answer(response))
                error = ServiceUnreachable("The service has ended the stream.")
            except grpc.RpcError as failed:
                error = grpc_wire.error_of(failed, None)
            finally:
                call.cancel()
            if not stream.over:
                tried += 1
                await asyncio.sleep(patience.pause_or_raise_s(tried, error))

    patience = retry.without_end()
    return carry
