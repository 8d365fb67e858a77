"""The client that robots import, for threads."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from types import TracebackType
from typing import Any, TypeVar, Unpack

from service.client.frames import BACKLOG, MAX_IN_FLIGHT, FrameBook
from service.client.grpc_transport import GrpcTransport
from service.client.question import Camera, Depth, Earlier, MaterialLike, Options, Push, Question, Shape, question
from service.client.result import Result
from service.client.retry import Attempts, Retry
from service.client.stream import FrameStream, carry_by_calls, carry_by_grpc
from service.client.transport import NamedMaterial, Transport, address
from service.core.errors import PhysNetError

T = TypeVar("T")

TIMEOUT_S = 10.0
"""The longest that a service lets a request take."""


class PhysNetClient:
    """Asks a service. May be shared by threads; use it as a context manager, or close it.

    Every method raises a `PhysNetError`: the service's own by their classes (`ContactOffBody`, `NoSupportPlane`, …),
    with `code`, `field`, `expected` and `actual`; `ServiceUnreachable`; `DeadlineExceeded`.

    Args:
        url: `http://HOST:PORT`, `https://…`, `grpc://HOST:PORT` or `grpcs://…`, from the service's ready line.
        timeout_s: Of each call, tries and pauses included, where the call names none.
        retry: What is tried again: see `Retry`.
        token: Where the service wants one.

    Raises:
        ValueError: `url` is none of these.
    """

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

    def deform(
        self,
        depth: Depth | Shape | Earlier,
        camera: Camera | None = None,
        push: Push | Iterable[Push] = (),
        material: MaterialLike = "silicone",
        *,
        timeout_s: float | None = None,
        **options: Unpack[Options],
    ) -> Result:
        """The full shape of the object in a depth frame, and the shape it takes under each push.

        Args:
            depth: Height × width, uint16 millimetres or float metres; a `.png` or `.npy` file; an `Image`; a `Shape`;
                or `result.earlier`, the body of an answer before.
            camera: Its intrinsics.
            push: One load or several.
            material: A name, a `Material`, or (Young's modulus in Pa, Poisson's ratio).
            timeout_s: Of this call.
            options: `mask`, `up`, `roi`, `unit_m`, `outputs`, `threshold`, `uncertainty_samples`: see
                `service.client.question.Options`.

        Raises:
            PhysNetError: What is wrong, and with which field.
            ValueError: An array is no image.
        """
        return self.ask(question(depth, camera, push, material, **options), timeout_s)

    def ask(self, asked: Question, timeout_s: float | None = None) -> Result:
        """`deform` for a question that is complete."""
        return self._patiently(lambda left_s: self._transport.deform(asked, left_s), timeout_s)

    def materials(self, query: str = "", *, timeout_s: float | None = None) -> list[NamedMaterial]:
        """Named materials whose name or description holds every word of `query`."""
        return self._patiently(lambda left_s: self._transport.materials(query, left_s), timeout_s)

    def models(self, *, timeout_s: float | None = None) -> list[dict[str, Any]]:
        """Manifests of the models that answer."""
        return self._patiently(self._transport.models, timeout_s)

    def wait_until_ready(self, timeout_s: float = 60.0) -> None:
        """Wait for a service that is being started.

        Raises:
            DeadlineExceeded: It was not ready in time.
            PhysNetError: It is there, and will not become ready by waiting.
        """
        self._patiently(self._transport.models, timeout_s, self._retry.without_end())

    def stream(
        self,
        *,
        max_in_flight: int = MAX_IN_FLIGHT,
        backlog: int = BACKLOG,
        with_skipped: bool = False,
        deadline_s: float | None = None,
    ) -> FrameStream:
        """A stream of frames in which the newest one wins, on both sides of the wire.

        Over gRPC it is one `DeformStream`, opened again where it breaks. Over HTTP, which has no streams, it is one
        request after the other, always about the newest frame there is.

        Args:
            max_in_flight: Most frames sent and not yet answered (gRPC).
            backlog: Most answers kept for a reader that is late; older ones are dropped and counted.
            with_skipped: Whether overtaken frames are answers too.
            deadline_s: Of each frame, from its arrival in the service until inference must have begun (gRPC).
        """
        book = FrameBook(max_in_flight, backlog, with_skipped)
        if isinstance(self._transport, GrpcTransport):
            return FrameStream(carry_by_grpc(self._transport, self._retry, deadline_s), book)
        once = Retry(attempts=1)
        return FrameStream(carry_by_calls(lambda asked: self._patiently(
            lambda left_s: self._transport.deform(asked, left_s), deadline_s, once)), book)  # fmt: skip

    def close(self) -> None:
        """Close the connections."""
        self._transport.close()

    def __enter__(self) -> PhysNetClient:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _patiently(self, ask: Callable[[float], T], timeout_s: float | None, retry: Retry | None = None) -> T:
        attempts = Attempts(retry or self._retry, self._timeout_s if timeout_s is None else timeout_s)
        while True:
            try:
                return ask(attempts.left_s())
            except PhysNetError as error:
                pause_s = attempts.pause_s(error)
            time.sleep(pause_s)


def _transport(url: str, token: str | None) -> Transport:
    where = address(url)
    if where.grpc:
        return GrpcTransport(where.target, secure=where.secure, token=token)
    # Here, because beside the service httpx is an extra, and gRPC does without.
    from service.client.http_transport import HttpTransport

    return HttpTransport(where.target, token)
