"""Traces: a span for each request and, inside it, one for each stage. Off unless a collector is named."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Protocol, runtime_checkable

Attributes = Mapping[str, str | int]

PROPAGATED = ("traceparent", "tracestate")
"""Headers and metadata by which a caller's trace goes on here (W3C Trace Context)."""


@runtime_checkable
class Span(Protocol):
    """One request, or one frame of a stream."""

    @property
    def trace_id(self) -> str:
        """32 hexadecimal digits, for the log; empty where nothing is traced."""

    def stages(self, timing_ms: Mapping[str, float]) -> None:
        """The stages of an answer that ends now, in their order; `total` is their whole."""

    def end(self, code: str, name: str | None = None) -> None:
        """It is over, with `ok` or the code of an error; `name` in place of the one it began with."""


@runtime_checkable
class Tracer(Protocol):
    """Begins spans."""

    def begin(self, name: str, carrier: Mapping[str, str], attributes: Attributes) -> Span:
        """A span that begins now, within the trace that `carrier` (headers, metadata) names, if it does."""

    def close(self) -> None:
        """Send what is left."""


class _NoSpan:
    trace_id = ""

    def stages(self, timing_ms: Mapping[str, float]) -> None:
        pass

    def end(self, code: str, name: str | None = None) -> None:
        pass


class _NoTracer:
    def begin(self, name: str, carrier: Mapping[str, str], attributes: Attributes) -> Span:
        return NO_SPAN

    def close(self) -> None:
        pass


NO_SPAN: Span = _NoSpan()
NO_TRACER: Tracer = _NoTracer()


def make_tracer(endpoint: str | None, share: float, version: str) -> Tracer:
    """What sends spans to the collector at `endpoint`; does nothing, and imports nothing, where that is None.

    Args:
        endpoint: Such as `http://127.0.0.1:4317`, where a collector takes OTLP over gRPC.
        share: Of the traces that begin here, 0 to 1; those that a caller began are sent where it sends its own.
        version: Of this service.

    Raises:
        ImportError: OpenTelemetry is not installed.
    """
    if endpoint is None:
        return NO_TRACER
    try:
        from service.api.tracing_otlp import OtlpTracer
    except ModuleNotFoundError as error:
        raise ImportError(f"Tracing needs `pip install physnet[tracing]`: {error}") from error
    return OtlpTracer(endpoint, share, version)
