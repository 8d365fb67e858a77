"""What surrounds every gRPC call: its id, the token, its deadline, errors as rich statuses, and the counting."""

from __future__ import annotations

import time
from types import TracebackType
from typing import Any, Protocol, runtime_checkable

from grpc_status import rpc_status

from service.api.context import check_token, log_done, log_error, request_id_of
from service.api.handler import Handler
from service.api.rpc_convert import rich_status
from service.api.tracing import PROPAGATED
from service.settings import Settings


@runtime_checkable
class Context(Protocol):
    """The part of a gRPC call's context that is used here; grpc's own object is of no public class."""

    def invocation_metadata(self) -> Any: ...
    def time_remaining(self) -> float | None: ...
    def set_trailing_metadata(self, metadata: Any) -> None: ...
    async def abort(self, code: Any, details: str = "", trailing_metadata: Any = ()) -> None: ...
    async def write(self, message: Any) -> None: ...


class Calls:
    """Surrounds the calls of all services of one server alike."""

    def __init__(self, handler: Handler, settings: Settings) -> None:
        self.metrics = handler.metrics
        self.tracer = handler.tracer
        self.longest_s = settings.request_deadline_s
        self.token = settings.token.get_secret_value() if settings.token else None

    def call(self, context: Context, route: str) -> Call:
        """For `async with`: whatever is raised inside becomes the status of the call."""
        return Call(self, context, route)


class Call:
    """One call.

    Attributes:
        request_id: The client's, else one made up.
        deadline: Time of `time.monotonic()` by which inference must have begun.
        span: Of the call.
        caller: Metadata that names the caller's trace.
    """

    def __init__(self, calls: Calls, context: Context, route: str) -> None:
        self._calls = calls
        self._context = context
        self._route = route
        self._started = time.perf_counter()
        self._metadata = {str(key): value for key, value in context.invocation_metadata() or ()}
        self.request_id = request_id_of(self._given("x-request-id"))
        self.caller = {name: self._given(name) for name in PROPAGATED if name in self._metadata}
        attributes = {"rpc.system": "grpc", "physnet.request_id": self.request_id}
        self.span = calls.tracer.begin(route.removeprefix("/"), self.caller, attributes)
        remaining_s = context.time_remaining()
        allowed_s = calls.longest_s if remaining_s is None else min(calls.longest_s, remaining_s)
        self.deadline = time.monotonic() + allowed_s

    async def __aenter__(self) -> Call:
        self._context.set_trailing_metadata((("x-request-id", self.request_id),))
        try:
            check_token(self._given("authorization"), self._calls.token)
        except Exception as error:
            await self._fail(error)
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if isinstance(error, Exception):
            await self._fail(error)
        # What is no Exception is the cancellation of the call: by its client, or at its deadline.
        self._count("ok" if error is None else "cancelled")

    async def _fail(self, error: Exception) -> None:
        code = log_error(error, self.request_id, self.span)
        self._count(code)
        status = rpc_status.to_status(rich_status(error, self.request_id))
        metadata = (*(status.trailing_metadata or ()), ("x-request-id", self.request_id))
        await self._context.abort(status.code, status.details or "", metadata)

    def _count(self, code: str) -> None:
        elapsed_s = time.perf_counter() - self._started
        self._calls.metrics.request("grpc", self._route, code, elapsed_s)
        self.span.end(code)
        log_done("grpc", self._route, code, elapsed_s, self.request_id, self.span)

    def _given(self, name: str) -> str:
        value = self._metadata.get(name, "")
        return value if isinstance(value, str) else value.decode("latin-1")
