"""What the service counts about itself, for Prometheus."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from prometheus_client import (
    CONTENT_TYPE_LATEST,
    CollectorRegistry,
    Counter,
    Gauge,
    Histogram,
    ProcessCollector,
    generate_latest,
)
from prometheus_client.core import CounterMetricFamily, GaugeMetricFamily
from prometheus_client.registry import Collector

from service.api.status import meanings
from service.core.manifest import Manifest

# The budget of a whole request is 20 ms and of a stage 1 to 10, so Prometheus' default buckets would show nothing.
BUCKETS_S = (
    0.0005, 0.001, 0.002, 0.003, 0.004, 0.005, 0.0075, 0.01, 0.0125, 0.015, 0.02, 0.025, 0.03, 0.04, 0.05,
    0.075, 0.1, 0.25, 1.0, 10.0,
)  # fmt: skip

STAGES = (
    "parse", "queue", "decode", "segment", "voxelize", "reconstruct", "align", "deform", "encode", "total",
)  # fmt: skip
"""Of a request; there from the start, so that a stage without a request is a zero and not a gap."""

NO_REFUSALS = frozenset({"ok", "skipped", "cancelled"})
"""Outcomes that are no refusal: answered, overtaken by a newer frame, given up by the client."""

__all__ = ["CONTENT_TYPE_LATEST", "Metrics", "State"]


@dataclass(frozen=True)
class State:
    """What is true at one moment.

    Attributes:
        ready: Whether requests are answered.
        queue_depth: Requests that wait for a worker.
        kept, kept_bytes: Reconstructions that may be asked again, and their memory.
        hits, misses: Questions to them since the start that found theirs, and that did not.
    """

    ready: bool = False
    queue_depth: int = 0
    kept: int = 0
    kept_bytes: int = 0
    hits: int = 0
    misses: int = 0


class Metrics:
    """One registry of its own, so that two services in one process (as in tests) do not mix their counts."""

    def __init__(self, state: Callable[[], State]) -> None:
        self.registry = registry = CollectorRegistry()
        registry.register(_StateCollector(state))
        ProcessCollector(registry=registry)
        self._stages = Histogram(
            "physnet_stage_seconds", "Wall time of each stage of an answer.", ("stage",),
            buckets=BUCKETS_S, registry=registry,
        )  # fmt: skip
        self._requests = Counter(
            "physnet_requests", "Requests by wire, route and outcome (`ok`, `skipped` or the code of the error).",
            ("wire", "route", "code"), registry=registry,
        )  # fmt: skip
        self._seconds = Histogram(
            "physnet_request_seconds",
            "Time from a request's first byte (of a stream's frame: its arrival) to its reply, of those answered.",
            ("wire", "route"), buckets=BUCKETS_S, registry=registry,
        )  # fmt: skip
        self._skipped = Counter(
            "physnet_skipped", "Frames of streams overtaken by a newer one before inference.", registry=registry
        )
        self._refused = Counter(
            "physnet_rejected", "Requests and frames refused or failed, by the code of the error.",
            ("wire", "reason"), registry=registry,
        )  # fmt: skip
        self._models = Gauge(
            "physnet_model_info", "The models served; always 1.", ("kind", "name", "version"), registry=registry
        )
        # Looked up once: a robot's thirty answers a second have ten stages each.
        self._by_stage = {stage: self._stages.labels(stage) for stage in STAGES}
        for wire in ("http", "grpc"):
            for code in meanings():
                self._refused.labels(wire, code)

    def models(self, manifests: Sequence[Manifest]) -> None:
        """The service now answers with these models."""
        for manifest in manifests:
            self._models.labels(manifest.kind, manifest.name, manifest.version).set(1)

    def stages(self, timing_ms: Mapping[str, float]) -> None:
        """Count the stage timings of one reply."""
        for stage, elapsed_ms in timing_ms.items():
            (self._by_stage.get(stage) or self._stages.labels(stage)).observe(elapsed_ms * 1e-3)

    def request(self, wire: str, route: str, code: str, elapsed_s: float) -> None:
        """Count one request, or one frame of a stream."""
        self._requests.labels(wire, route, code).inc()
        if code == "ok":
            self._seconds.labels(wire, route).observe(elapsed_s)
        elif code == "skipped":
            self._skipped.inc()
        elif code not in NO_REFUSALS:
            self._refused.labels(wire, code).inc()

    def exposition(self) -> bytes:
        """Prometheus' text format."""
        return generate_latest(self.registry)


class _StateCollector(Collector):
    """Reads the state when Prometheus asks for it."""

    def __init__(self, state: Callable[[], State]) -> None:
        self._state = state

    def describe(self) -> Iterable[GaugeMetricFamily | CounterMetricFamily]:
        return ()

    def collect(self) -> Iterable[GaugeMetricFamily | CounterMetricFamily]:
        state = self._state()
        for name, meaning, value in (
            ("ready", "1 while the models are loaded, warmed up and the service is not stopping.", state.ready),
            ("queue_depth", "Requests that wait for a worker.", state.queue_depth),
            ("reconstructions_kept", "Reconstructions that may be asked again.", state.kept),
            ("reconstructions_kept_bytes", "Memory of the reconstructions that may be asked again.", state.kept_bytes),
        ):
            yield GaugeMetricFamily(f"physnet_{name}", meaning, value=float(value))
        hits = CounterMetricFamily(
            "physnet_reconstructions_asked", "Reconstructions asked again by their id.", labels=("outcome",)
        )
        hits.add_metric(["hit"], state.hits)
        hits.add_metric(["gone"], state.misses)
        yield hits
