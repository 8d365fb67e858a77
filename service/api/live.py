"""`/v1/live`: one WebSocket that follows a slider. A frame comes once, then only loads and materials; the newest wins.

A message may be overtaken by a newer one while it waits for a worker; it is then answered `skipped` at once. Every
message has one answer. The reconstruction is kept between them, so that a push costs no more than its deformation.
"""

from __future__ import annotations

import asyncio
import time
import uuid
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Any
from urllib.parse import urlsplit

from fastapi import APIRouter, WebSocket, WebSocketDisconnect
from pydantic_core import to_json

from service.api import convert
from service.api.context import check_token, log_error
from service.api.handler import Handler
from service.api.live_frames import LiveHead, answer_parts, encode_answer, parse_message
from service.api.problem import problem_document
from service.api.schemas import DeformBody
from service.core.errors import InvalidRequest, ReconstructionGone
from service.core.messages import DeformRequest, DeformResult, EarlierReconstruction
from service.scheduler import Answer, Overtaken, Place
from service.settings import Settings

ROUTE = "/v1/live"

UNANSWERED = 8
"""Messages read whose answer is not yet written; at that number reading waits for a client that doesn't read."""

POLICY_VIOLATION = 1008


def create_live(handler: Handler, settings: Settings) -> APIRouter:
    """The route `/v1/live`."""
    router = APIRouter()

    @router.websocket(ROUTE)
    async def live(socket: WebSocket) -> None:
        # A page from elsewhere could otherwise ask a robot's service through the browser of whoever looks at it.
        if not _same_origin(socket.headers.get("origin"), socket.headers.get("host", "")):
            await socket.close(POLICY_VIOLATION, "another origin")
            return
        await socket.accept()
        with suppress(WebSocketDisconnect):
            await _Connection(socket, handler, settings).run()

    return router


def _same_origin(origin: str | None, host: str) -> bool:
    """Programs send no origin; browsers always do."""
    return origin is None or urlsplit(origin).netloc == host


@dataclass
class _Asked:
    """Attributes:
    frame: The client's number, None where the message did not come to that.
    arrived: `time.perf_counter()` when it had arrived.
    body_version: The frame of the body it asks about.
    overtaken_by: The message that took its place.
    """

    frame: int | None
    arrived: float
    body_version: int = 0
    overtaken_by: int | None = None


class _Connection:
    """One client, from its first message to its last."""

    def __init__(self, socket: WebSocket, handler: Handler, settings: Settings) -> None:
        self._socket = socket
        self._handler = handler
        self._settings = settings
        self._token = settings.token.get_secret_value() if settings.token else None
        self._trusted = self._token is None
        self._id = uuid.uuid4().hex
        self._room = asyncio.Semaphore(UNANSWERED)
        self._writing = asyncio.Lock()
        self._answering: set[asyncio.Task[None]] = set()
        self._last_frame = -1
        self._offered: _Asked | None = None
        # The frame that pushes are about, how often it has changed, and where its reconstruction is kept.
        self._body: DeformBody | None = None
        self._files: dict[str, bytes] = {}
        self._body_version = 0
        self._reconstruction_id: str | None = None

    async def run(self) -> None:
        place: Place | None = None
        try:
            while True:
                await self._room.acquire()
                asked = _Asked(None, 0.0)
                data = await self._receive()
                asked.arrived = time.perf_counter()
                try:
                    question = self._question(data, asked)
                    place = place or self._handler.place()
                    self._offer(place, question, asked)
                except Exception as error:
                    await self._refuse(asked, error)
        finally:
            if place is not None:
                place.leave()
            for task in self._answering:
                task.cancel()

    async def _receive(self) -> bytes | str:
        message = await self._socket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect(message.get("code", 1000))
        data: bytes | str | None = message.get("bytes")
        return message["text"] if data is None else data

    def _question(self, data: bytes | str, asked: _Asked) -> DeformRequest:
        message = parse_message(data)
        head = message.head
        if head.frame <= self._last_frame:
            raise InvalidRequest(
                "Messages are numbered upwards: this number is not greater than the one before.",
                field="frame", expected=f"> {self._last_frame}", actual=str(head.frame),
            )  # fmt: skip
        asked.frame = self._last_frame = head.frame
        if not self._trusted:
            check_token(f"Bearer {head.token or ''}", self._token)
            self._trusted = True
        question = self._opened(head, dict(message.files)) if head.request else self._pushed(head)
        asked.body_version = self._body_version
        return question

    def _opened(self, head: LiveHead, files: dict[str, bytes]) -> DeformRequest:
        assert head.request is not None
        if head.push is not None or len(head.request.loads) != 1:
            raise InvalidRequest(
                "A live request has one load, and `push` comes without it.", field="request.loads", expected="one load"
            )
        question = convert.deform_request(head.request, max_loads=1, files=files or None)
        self._body, self._files = head.request, files
        self._body_version += 1
        self._reconstruction_id = None
        return question

    def _pushed(self, head: LiveHead) -> DeformRequest:
        if head.push is None:
            raise InvalidRequest("Send `request` or `push`.", field="request", expected="exactly one of the two")
        if self._body is None:
            raise InvalidRequest("There is no body yet: the first message is a `request`.", field="push")
        push = head.push
        self._body = self._body.model_copy(
            update={
                "material": push.material, "loads": push.loads, "uncertainty_samples": push.uncertainty_samples
            }
        )  # fmt: skip
        question = convert.deform_request(self._body, max_loads=1, files=self._files or None)
        if push.reconstruct:
            self._body_version += 1
            self._reconstruction_id = None
        if self._reconstruction_id is None:
            return question
        return replace(question, source=EarlierReconstruction(self._reconstruction_id))

    def _offer(self, place: Place, question: DeformRequest, asked: _Asked) -> None:
        parsed = time.perf_counter()
        answer = place.offer(question, time.monotonic() + self._settings.request_deadline_s)
        if self._offered is not None:
            self._offered.overtaken_by = asked.frame
        self._offered = asked
        task = asyncio.create_task(self._answer(answer, question, asked, parsed))
        self._answering.add(task)
        task.add_done_callback(self._answering.discard)

    async def _answer(
        self, answer: asyncio.Future[Answer[DeformResult]], question: DeformRequest, asked: _Asked, parsed: float
    ) -> None:
        try:
            try:
                answered = await answer
            except ReconstructionGone:
                # It made room for others'. Reconstructing once more in turn is cheaper than asking the client to.
                self._reconstruction_id = None
                assert self._body is not None
                source = convert.deform_request(self._body, max_loads=1, files=self._files or None).source
                deadline = time.monotonic() + self._settings.request_deadline_s
                question = replace(question, source=source)
                answered = await self._handler.deform(question, deadline)
            encoded = self._encoded(answered, question, asked, parsed)
        except Overtaken:
            await self._send(asked, {"frame": asked.frame, "skipped": {"overtaken_by": asked.overtaken_by}}, "skipped")
        except Exception as error:
            await self._refuse(asked, error)
        else:
            await self._send(asked, encoded, "ok")

    def _encoded(
        self, answered: Answer[DeformResult], question: DeformRequest, asked: _Asked, parsed: float
    ) -> bytes:
        began = time.perf_counter()
        result = answered.result
        with_body = not isinstance(question.source, EarlierReconstruction)
        if with_body and asked.body_version == self._body_version:
            self._reconstruction_id = result.reconstruction_id
        found = {manifest.kind: manifest.threshold for manifest in self._handler.manifests}
        threshold = question.threshold or found.get("reconstruction", 0.5)
        parts = answer_parts(result, with_body, threshold)
        load = result.loads[0]
        timing_ms = {"parse": 1e3 * (parsed - asked.arrived), "queue": 1e3 * answered.queued_s}
        timing_ms |= {stage: ms for stage, ms in result.timing_ms.items() if stage != "total"}
        now = time.perf_counter()
        timing_ms |= {"encode": 1e3 * (now - began), "total": 1e3 * (now - asked.arrived)}
        head: dict[str, Any] = {
            "frame": asked.frame,
            "body": asked.body_version,
            "model": {"name": result.model_name, "version": result.model_version},
            "grid": {
                "voxel_size_m": result.grid.pitch_m,
                "camera_from_grid": result.grid.camera_from_grid.tolist(),
            },
            "threshold": threshold,
            "max_displacement_m": load.max_displacement_m,
            "mean_displacement_m": load.mean_displacement_m,
            "load_number": load.load_number,
            "flags": sorted(result.flags | load.flags),
            "timing_ms": timing_ms,
        }
        self._handler.metrics.stages(timing_ms)
        return encode_answer(head, parts)

    async def _refuse(self, asked: _Asked, error: Exception) -> None:
        code = log_error(error, self._id)
        await self._send(asked, {"frame": asked.frame, "problem": problem_document(error, self._id)}, code)

    async def _send(self, asked: _Asked, message: bytes | dict[str, Any], code: str) -> None:
        self._handler.metrics.request("websocket", ROUTE, code, time.perf_counter() - asked.arrived)
        try:
            async with self._writing:
                if isinstance(message, bytes):
                    await self._socket.send_bytes(message)
                else:
                    await self._socket.send_text(to_json(message, inf_nan_mode="null").decode())
        except (WebSocketDisconnect, RuntimeError):
            # Gone in the meantime; the reading side hears of it too, and ends the connection.
            return
        finally:
            self._room.release()
