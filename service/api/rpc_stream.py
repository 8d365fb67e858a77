"""A stream of frames in which the newest one wins.

Frames are read as they come. One waits at most (`service.scheduler.Place`); a newer
frame takes the place of the one that waits, which is answered `skipped` at once. Every frame has one response.
"""

from __future__ import annotations

import asyncio
import logging
import math
import time
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable
from dataclasses import dataclass, field

from service.api.context import log_done, log_error
from service.api.generated import deformation_pb2 as pb
from service.api.handler import Handler
from service.api.rpc_call import Call
from service.api.rpc_convert import problem_message
from service.api.tracing import Span
from service.core.errors import InvalidRequest
from service.core.messages import DeformRequest, DeformResult
from service.scheduler import Answer, Overtaken, Place
from service.settings import Settings

log = logging.getLogger(__name__)

UNANSWERED = 32
"""Frames read whose response is not yet written. At that number reading pauses: a client that doesn't read its
responses is held back by HTTP/2's flow control instead of filling the service's memory."""

ROUTE = "/physnet.v1.DeformationService/DeformStream#frame"

Respond = Callable[[Answer[DeformResult], DeformRequest, str, float, float, Span], Awaitable[pb.DeformResponse]]


@dataclass
class _Frame:
    """Attributes:
    frame_id: The client's.
    arrived: `time.perf_counter()` when it had arrived whole.
    span: Of the frame.
    overtaken_by: The frame that took its place, once one has.
    age_ms: Age at the end of each stage.
    """

    frame_id: int
    arrived: float
    span: Span
    overtaken_by: int | None = None
    age_ms: dict[str, float] = field(default_factory=dict)

    def reached(self, stage: str) -> None:
        self.age_ms[stage] = 1e3 * (time.perf_counter() - self.arrived)


class FrameStream:
    """One stream, from its first frame to its last response.

    Args:
        handler: Answers.
        settings: The longest a frame may wait.
        question: From a message to a request; raises what is wrong with it.
        respond: From an answer to a message.
        write: Sends one response; waits while the client doesn't take any.
        call: The stream's; its frames have its request id and their own, and belong to its caller's trace.
    """

    def __init__(
        self, handler: Handler, settings: Settings, question: Callable[[pb.DeformRequest], DeformRequest],
        respond: Respond, write: Callable[[pb.DeformStreamResponse], Awaitable[None]], call: Call,
    ) -> None:  # fmt: skip
        self._handler = handler
        self._longest_s = settings.request_deadline_s
        self._question = question
        self._respond = respond
        self._write = write
        self._request_id = call.request_id
        self._caller = call.caller
        self._counts: Counter[str] = Counter()
        self._room = asyncio.Semaphore(UNANSWERED)
        self._outgoing: asyncio.Queue[tuple[_Frame, pb.DeformStreamResponse] | None] = asyncio.Queue()
        self._answering: set[asyncio.Task[None]] = set()
        self._last_id = -1
        self._offered: _Frame | None = None

    async def run(self, frames: AsyncIterator[pb.DeformStreamRequest]) -> None:
        """Serve until the client has sent its last frame and has its last response, or goes away."""
        place = self._handler.place()
        writing = asyncio.create_task(self._write_all())
        reading = asyncio.create_task(self._read_all(frames, place))
        try:
            # A write that fails means that nobody reads any more, so that reading on would serve nobody.
            await asyncio.wait({reading, writing}, return_when=asyncio.FIRST_COMPLETED)
            if reading.done():
                reading.result()
                await asyncio.gather(*self._answering)
                self._outgoing.put_nowait(None)
            await writing
        finally:
            place.leave()
            counts = dict(self._counts)
            log.info(
                "stream ended: %s request=%s", counts, self._request_id,
                extra={"request_id": self._request_id, "frames": counts},
            )  # fmt: skip
            for task in (reading, writing, *self._answering):
                task.cancel()

    async def _read_all(self, frames: AsyncIterator[pb.DeformStreamRequest], place: Place) -> None:
        await self._room.acquire()
        async for message in frames:
            frame = _Frame(message.frame_id, time.perf_counter(), self._span(message.frame_id))
            try:
                self._take(message, frame, place)
            except Exception as error:
                self._refuse(frame, error)
            await self._room.acquire()

    def _take(self, message: pb.DeformStreamRequest, frame: _Frame, place: Place) -> None:
        if frame.frame_id <= self._last_id:
            raise InvalidRequest(
                "Frames of a stream are numbered upwards: this id is not greater than the one before.",
                field="frame_id", expected=f"> {self._last_id}", actual=str(frame.frame_id),
            )  # fmt: skip
        self._last_id = frame.frame_id
        deadline = time.monotonic() + self._allowed_s(message)
        if not message.HasField("request"):
            raise InvalidRequest("`request` is missing.", field="request", expected="a value", actual="nothing")
        question = self._question(message.request)
        parsed = time.perf_counter()
        frame.reached("parse")
        answer = place.offer(question, deadline)
        # The one it overtakes, if it does, hears of it only when the event loop turns next.
        if self._offered is not None:
            self._offered.overtaken_by = frame.frame_id
        self._offered = frame
        task = asyncio.create_task(self._answer(frame, answer, question, parsed))
        self._answering.add(task)
        task.add_done_callback(self._answering.discard)

    async def _answer(
        self, frame: _Frame, answer: asyncio.Future[Answer[DeformResult]], question: DeformRequest, parsed: float
    ) -> None:
        try:
            answered = await answer
            age_ms = frame.age_ms["parse"]
            stages = {"queue": 1e3 * answered.queued_s, **answered.result.timing_ms}
            for stage, elapsed_ms in stages.items():
                if stage != "total":
                    age_ms += elapsed_ms
                    frame.age_ms[stage] = age_ms
            response = await self._respond(answered, question, self._id(frame), frame.arrived, parsed, frame.span)
            frame.reached("encode")
        except Overtaken:
            skipped = pb.Skipped(overtaken_by_frame_id=frame.overtaken_by)
            self._send(frame, pb.DeformStreamResponse(skipped=skipped), "skipped")
        except Exception as error:
            self._refuse(frame, error)
        else:
            self._send(frame, pb.DeformStreamResponse(answer=response), "ok")

    def _refuse(self, frame: _Frame, error: Exception) -> None:
        code = log_error(error, self._id(frame), frame.span)
        self._send(frame, pb.DeformStreamResponse(problem=problem_message(error, self._id(frame))), code)

    def _send(self, frame: _Frame, response: pb.DeformStreamResponse, code: str) -> None:
        response.frame_id = frame.frame_id
        elapsed_s = time.perf_counter() - frame.arrived
        self._counts[code] += 1
        self._handler.metrics.request("grpc", ROUTE, code, elapsed_s)
        frame.span.end(code)
        log_done("grpc", ROUTE, code, elapsed_s, self._id(frame), frame.span)
        self._outgoing.put_nowait((frame, response))

    async def _write_all(self) -> None:
        while (item := await self._outgoing.get()) is not None:
            frame, response = item
            frame.reached("reply")
            response.age_ms.update(frame.age_ms)
            try:
                await self._write(response)
            except Exception as error:  # gRPC has several kinds, none of them public, for a client that has gone
                log.info("stream has no reader any more: %s request=%s", error, self._request_id)
                return
            self._room.release()

    def _span(self, frame_id: int) -> Span:
        attributes = {
            "rpc.system": "grpc", "physnet.request_id": f"{self._request_id}/{frame_id}",
            "physnet.frame_id": str(frame_id),
        }  # fmt: skip
        return self._handler.tracer.begin(ROUTE.removeprefix("/"), self._caller, attributes)

    def _id(self, frame: _Frame) -> str:
        return f"{self._request_id}/{frame.frame_id}"

    def _allowed_s(self, message: pb.DeformStreamRequest) -> float:
        if not message.HasField("deadline_ms"):
            return self._longest_s
        if not (math.isfinite(message.deadline_ms) and message.deadline_ms > 0.0):
            raise InvalidRequest(
                "`deadline_ms` must be a positive number of milliseconds.",
                field="deadline_ms", expected="> 0", actual=str(message.deadline_ms),
            )  # fmt: skip
        return min(self._longest_s, 1e-3 * message.deadline_ms)
