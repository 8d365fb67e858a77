"""From a service's description to its handlers, which know what to say of bytes that are no message."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from typing import Any

import grpc
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass

from service.api.rpc_call import Calls, Context
from service.core.errors import InvalidRequest


class _Malformed:
    """In place of a message that could not be read: grpc itself would answer UNKNOWN without a word of ours."""


def _not_a_message() -> InvalidRequest:
    return InvalidRequest("The message cannot be read: it is truncated or of another type.", expected="a message")


def generic_handler(description: Any, servicer: object, calls: Calls) -> grpc.GenericRpcHandler:
    """Handlers of every method that `servicer` has; others are answered UNIMPLEMENTED.

    Args:
        description: Descriptor of the service.
        servicer: Has a coroutine of each method's name, called with the request (or their iterator) and the context.
        calls: Says what is wrong in its words.
    """
    handlers: dict[str, Any] = {}
    for method in description.methods:
        behaviour = getattr(servicer, method.name, None)
        if behaviour is None:
            continue
        streams = method.client_streaming
        make = grpc.stream_stream_rpc_method_handler if streams else grpc.unary_unary_rpc_method_handler
        handlers[method.name] = make(
            _stream(behaviour) if streams else _unary(behaviour, calls, f"/{description.full_name}/{method.name}"),
            request_deserializer=_reader(GetMessageClass(method.input_type)),
            response_serializer=lambda message: message.SerializeToString(),
        )
    return grpc.method_handlers_generic_handler(description.full_name, handlers)


def _reader(message_class: Any) -> Callable[[bytes], Any]:
    def read(data: bytes) -> Any:
        try:
            return message_class.FromString(data)
        except DecodeError:
            return _Malformed()

    return read


def _unary(behaviour: Any, calls: Calls, route: str) -> Any:
    async def handle(request: Any, context: Context) -> Any:
        if isinstance(request, _Malformed):
            async with calls.call(context, route):
                raise _not_a_message()
        return await behaviour(request, context)

    return handle


def _stream(behaviour: Any) -> Any:
    async def readable(requests: AsyncIterator[Any]) -> AsyncIterator[Any]:
        async for request in requests:
            if isinstance(request, _Malformed):
                raise _not_a_message()
            yield request

    async def handle(requests: AsyncIterator[Any], context: Context) -> None:
        await behaviour(readable(requests), context)

    return handle
