"""The wires that are asked: each sends one question and tells what became of it."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol, runtime_checkable

import grpc
import orjson

from service.api.generated import deformation_pb2 as pb
from service.api.generated.deformation_pb2_grpc import DeformationServiceStub
from service.bench.question import BOUNDARY, BenchQuestion

OK, SKIPPED = "ok", "skipped"
"""Outcomes; any other is the code of an error."""

LIMITS = [
    ("grpc.max_receive_message_length", -1),
    ("grpc.max_send_message_length", -1),
    # Clients of one process share connections otherwise.
    ("grpc.use_local_subchannel_pool", 1),
]


@dataclass(frozen=True)
class Reply:
    """Attributes:
    outcome: `ok`, `skipped` (a stream's frame that was overtaken) or an error's code.
    finished: `time.perf_counter()` when the whole reply was there.
    timing_ms: Stages by the service's own watch; empty without an answer.
    """

    outcome: str
    finished: float
    timing_ms: Mapping[str, float] = field(default_factory=dict)


@runtime_checkable
class Target(Protocol):
    """One client with a connection of its own."""

    async def open(self) -> None: ...
    async def ask(self) -> Reply: ...
    async def close(self) -> None: ...


class GrpcUnary:
    """`Deform`."""

    def __init__(self, address: str, question: BenchQuestion) -> None:
        self._address = address
        self._question = question.message

    async def open(self) -> None:
        self._channel = grpc.aio.insecure_channel(self._address, options=LIMITS)
        self._stub: Any = DeformationServiceStub(self._channel)
        await self._channel.channel_ready()

    async def ask(self) -> Reply:
        try:
            response = await self._stub.Deform(self._question)
        except grpc.aio.AioRpcError as error:
            return Reply(error.code().name.lower(), time.perf_counter())
        return Reply(OK, time.perf_counter(), dict(response.timing_ms))

    async def close(self) -> None:
        await self._channel.close()


class GrpcStream:
    """`DeformStream`: the newest frame wins, and each has its own response."""

    def __init__(self, address: str, question: BenchQuestion) -> None:
        self._address = address
        self._question = question.message
        self._next_id = 0
        self._waiting: dict[int, asyncio.Future[Reply]] = {}
        # A call takes one write at a time.
        self._writing = asyncio.Lock()

    async def open(self) -> None:
        self._channel = grpc.aio.insecure_channel(self._address, options=LIMITS)
        await self._channel.channel_ready()
        stub: Any = DeformationServiceStub(self._channel)
        self._call = stub.DeformStream()
        self._reading = asyncio.create_task(self._read())

    async def ask(self) -> Reply:
        reply: asyncio.Future[Reply] = asyncio.get_running_loop().create_future()
        async with self._writing:
            frame_id, self._next_id = self._next_id, self._next_id + 1
            self._waiting[frame_id] = reply
            try:
                await self._call.write(pb.DeformStreamRequest(frame_id=frame_id, request=self._question))
            except (grpc.aio.AioRpcError, asyncio.InvalidStateError):
                # The stream has ended, and with it every frame on it; the reader may have told them already.
                self._lost("closed")
        return await reply

    async def _read(self) -> None:
        try:
            async for response in self._call:
                finished = time.perf_counter()
                outcome = response.WhichOneof("outcome")
                if outcome == "answer":
                    reply = Reply(OK, finished, dict(response.answer.timing_ms))
                else:
                    reply = Reply(SKIPPED if outcome == "skipped" else response.problem.code, finished)
                if (waiting := self._waiting.pop(response.frame_id, None)) is not None:
                    waiting.set_result(reply)
            self._lost("closed")
        except grpc.aio.AioRpcError as error:
            self._lost(error.code().name.lower())

    def _lost(self, code: str) -> None:
        while self._waiting:
            _, reply = self._waiting.popitem()
            if not reply.done():
                reply.set_result(Reply(code, time.perf_counter()))

    async def close(self) -> None:
        await self._call.done_writing()
        await asyncio.wait({self._reading}, timeout=10.0)
        self._call.cancel()
        await self._channel.close()


class Http:
    """`POST /v1/deform`, JSON or multipart, on connections that are kept; one more is opened where all are busy."""

    def __init__(self, address: str, question: BenchQuestion, *, multipart: bool) -> None:
        self._host, _, port = address.rpartition(":")
        self._port = int(port)
        body = question.multipart if multipart else question.json
        kind = f"multipart/form-data; boundary={BOUNDARY}" if multipart else "application/json"
        self._request = (
            f"POST /v1/deform HTTP/1.1\r\nHost: {address}\r\nContent-Type: {kind}\r\n"
            f"Content-Length: {len(body)}\r\nAccept: application/json\r\n\r\n"
        ).encode() + body
        self._idle: list[tuple[asyncio.StreamReader, asyncio.StreamWriter]] = []

    async def open(self) -> None:
        self._idle.append(await self._connect())

    async def ask(self) -> Reply:
        try:
            reader, writer = self._idle.pop() if self._idle else await self._connect()
            writer.write(self._request)
            await writer.drain()
            status, body = await _read_response(reader)
        except (OSError, asyncio.IncompleteReadError) as error:
            return Reply(type(error).__name__.lower(), time.perf_counter())
        finished = time.perf_counter()
        self._idle.append((reader, writer))
        document = orjson.loads(body)
        if status != 200:
            return Reply(str(document.get("code", status)), finished)
        return Reply(OK, finished, document["timing_ms"])

    async def close(self) -> None:
        for _, writer in self._idle:
            writer.close()

    async def _connect(self) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        # The reader's buffer holds a whole reply, so that the service never waits for us.
        return await asyncio.open_connection(self._host.strip("[]"), self._port, limit=2**22)


async def _read_response(reader: asyncio.StreamReader) -> tuple[int, bytes]:
    head = await reader.readuntil(b"\r\n\r\n")
    status_line, *lines = head.split(b"\r\n")
    headers = {name.strip().lower(): value.strip() for name, _, value in (line.partition(b":") for line in lines)}
    return int(status_line.split()[1]), await reader.readexactly(int(headers[b"content-length"]))


TARGETS = ("grpc-stream", "grpc", "http-multipart", "http-json")
"""What `make_target` knows."""


def make_target(name: str, http: str, grpc_address: str, question: BenchQuestion) -> Target:
    """A client of one of `TARGETS`; addresses are HOST:PORT."""
    match name:
        case "grpc-stream":
            return GrpcStream(grpc_address, question)
        case "grpc":
            return GrpcUnary(grpc_address, question)
        case "http-multipart" | "http-json":
            return Http(http, question, multipart=name == "http-multipart")
    raise ValueError(f"{name} is none of {', '.join(TARGETS)}")
