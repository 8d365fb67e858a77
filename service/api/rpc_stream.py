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
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

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

Fill = Callable[[pb.DeformResponse, DeformRequest, str, float, float, Answer[DeformResult]], Mapping[str, float]]


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
        self.age_ms[stage] = self.age()

    def age(self) -> float:
        """In milliseconds."""
        return 1e3 * (time.perf_counter() - self.arrived)


class FrameStream:
    """One stream, from its first frame to its last response.

    Args:
        handler: Answers.
        settings: The longest a frame may wait.
        question: From a message to a request; raises what is wrong with it.
        fill: Fills an answer in and returns its timings; called in the worker's thread.
        write: Sends one response; waits while the client doesn't take any.
        call: The stream's; its frames have its request id and their own, and belong to its caller's trace.
    """

    def __init__(
        self, handler: Handler, settings: Settings, question: Callable[[pb.DeformRequest], DeformRequest],
        fill: Fill, write: Callable[[pb.DeformStreamResponse], Awaitable[None]], call: Call,
    ) -> None:  # fmt: skip
        self._handler = handler
        self._longest_s = settings.request_deadline_s
        self._question = question
        self._fill = fill
        self._write = write
        self._request_id = call.request_id
        self._caller = call.caller
        self._counts: Counter[str] = Counter()
        self._room = asyncio.Semaphore(UNANSWERED)
        self._outgoing: asyncio.Queue[tuple[_Frame, pb.DeformStreamResponse] | None] = asyncio.Queue()
        self._answering: set[asyncio.Future[Any]] = set()
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
                await asyncio.gather(*self._answering, return_exceptions=True)
                self._outgoing.put_nowait(None)
            await writing
        finally:
            place.leave()
            counts = dict(self._counts)
            log.info(
                "stream ended: %s request=%s", counts, self._request_id,
                extra={"request_id": self._request_id, "frames": counts},
            )  # fmt: skip
            for future in (reading, writing, *self._answering):
                future.cancel()

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
        response = pb.DeformStreamResponse(frame_id=frame.frame_id)
        answer = place.offer(question, deadline, partial(self._encode, frame, response, question, parsed))
        # The one it overtakes, if it does, hears of it only when the event loop turns next.
        if self._offered is not None:
            self._offered.overtaken_by = frame.frame_id
        self._offered = frame
        self._answering.add(answer)
        answer.add_done_callback(partial(self._tell, frame, response))

    def _encode(
        self, frame: _Frame, response: pb.DeformStreamResponse, question: DeformRequest, parsed: float,
        answer: Answer[DeformResult],
    ) -> Mapping[str, float]:  # fmt: skip
        """In the worker's thread: the response, but for its last age; returns the answer's timings."""
        timing_ms = self._fill(response.answer, question, self._id(frame), frame.arrived, parsed, answer)
        age_ms = frame.age_ms["parse"]
        for stage, elapsed_ms in {"queue": timing_ms["queue"], **answer.result.timing_ms}.items():
            if stage != "total":
                age_ms += elapsed_ms
                frame.age_ms[stage] = age_ms
        frame.reached("encode")
        response.age_ms.update(frame.age_ms)
        return timing_ms

    def _tell(
        self, frame: _Frame, response: pb.DeformStreamResponse, answer: asyncio.Future[Answer[Mapping[str, float]]]
    ) -> None:
        self._answering.discard(answer)
        if answer.cancelled():
            return  # with the stream
        try:
            timing_ms = answer.result().result
        except Overtaken:
            skipped = pb.Skipped(overtaken_by_frame_id=frame.overtaken_by)
            self._send(frame, _response(frame, skipped=skipped), "skipped")
        except Exception as error:
            self._refuse(frame, error)
        else:
            self._send(frame, response, "ok", timing_ms)

    def _refuse(self, frame: _Frame, error: Exception) -> None:
        code = log_error(error, self._id(frame), frame.span)
        self._send(frame, _response(frame, problem=problem_message(error, self._id(frame))), code)

    def _send(
        self, frame: _Frame, response: pb.DeformStreamResponse, code: str, timing_ms: Mapping[str, float] | None = None
    ) -> None:
        # First of all, so that the event loop writes it before it counts.
        self._outgoing.put_nowait((frame, response))
        elapsed_s = time.perf_counter() - frame.arrived
        self._counts[code] += 1
        if timing_ms is not None:
            self._handler.answered(timing_ms, frame.span)
        asyncio.get_running_loop().call_soon(self._handler.metrics.request, "grpc", ROUTE, code, elapsed_s)
        frame.span.end(code)
        log_done("grpc", ROUTE, code, elapsed_s, self._id(frame), frame.span)

    async def _write_all(self) -> None:
        while (item := await self._outgoing.get()) is not None:
            frame, response = item
            response.age_ms["reply"] = frame.age()
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


def _response(frame: _Frame, **outcome: pb.Skipped | pb.Problem) -> pb.DeformStreamResponse:
    """To a frame that has no answer, with the ages that it reached."""
    return pb.DeformStreamResponse(frame_id=frame.frame_id, age_ms=frame.age_ms, **outcome)  # type: ignore[arg-type]
