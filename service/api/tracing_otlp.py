"""Traces by OpenTelemetry, sent to a collector over OTLP. Imported where tracing is on, and nowhere else."""

from __future__ import annotations

import time
from collections.abc import Mapping

from opentelemetry.exporter.otlp.proto.grpc.trace_exporter import OTLPSpanExporter
from opentelemetry.sdk.resources import Resource
from opentelemetry.sdk.trace import TracerProvider
from opentelemetry.sdk.trace.export import BatchSpanProcessor
from opentelemetry.sdk.trace.sampling import ParentBased, TraceIdRatioBased
from opentelemetry.trace import Span, SpanKind, Status, StatusCode, Tracer, format_trace_id, set_span_in_context
from opentelemetry.trace.propagation.tracecontext import TraceContextTextMapPropagator

from service.api.status import meanings
from service.api.tracing import PROPAGATED, Attributes

EXPORT_DELAY_MS = 1000
"""Spans are sent together, once a second or by the 512."""


class OtlpTracer:
    """See `service.api.tracing.make_tracer`."""

    def __init__(self, endpoint: str, share: float, version: str) -> None:
        resource = Resource.create({"service.name": "physnet", "service.version": version})
        self._provider = TracerProvider(
            resource=resource, sampler=ParentBased(TraceIdRatioBased(share)), shutdown_on_exit=False
        )
        exporter = OTLPSpanExporter(endpoint=endpoint)
        self._provider.add_span_processor(BatchSpanProcessor(exporter, schedule_delay_millis=EXPORT_DELAY_MS))
        self._tracer = self._provider.get_tracer("physnet", version)
        self._propagator = TraceContextTextMapPropagator()

    def begin(self, name: str, carrier: Mapping[str, str], attributes: Attributes) -> OtlpSpan:
        """See `service.api.tracing.Tracer`."""
        caller = {key: carrier[key] for key in PROPAGATED if key in carrier}
        context = self._propagator.extract(caller)
        span = self._tracer.start_span(name, context, SpanKind.SERVER, dict(attributes))
        return OtlpSpan(self._tracer, span)

    def close(self) -> None:
        """See `service.api.tracing.Tracer`."""
        self._provider.shutdown()


class OtlpSpan:
    """See `service.api.tracing.Span`."""

    def __init__(self, tracer: Tracer, span: Span) -> None:
        self._tracer = tracer
        self._span = span

    @property
    def trace_id(self) -> str:
        return format_trace_id(self._span.get_span_context().trace_id)

    def stages(self, timing_ms: Mapping[str, float]) -> None:
        """See `service.api.tracing.Span`. Stages follow each other at once, so they are laid end to end."""
        if not self._span.is_recording():
            return
        context = set_span_in_context(self._span)
        began = time.time_ns() - int(1e6 * timing_ms.get("total", 0.0))
        for stage, elapsed_ms in timing_ms.items():
            if stage == "total":
                continue
            child = self._tracer.start_span(stage, context, start_time=began)
            began += int(1e6 * elapsed_ms)
            child.end(began)

    def end(self, code: str, name: str | None = None) -> None:
        """See `service.api.tracing.Span`."""
        if name is not None:
            self._span.update_name(name)
        self._span.set_attribute("physnet.code", code)
        # By convention a server's span has failed where the server did, not where it refused.
        known = meanings().get(code)
        if known is not None and known.http >= 500:
            self._span.set_status(Status(StatusCode.ERROR, code))
        self._span.end()
