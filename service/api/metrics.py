"""What the service counts about itself, for Prometheus."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from prometheus_client import CONTENT_TYPE_LATEST, CollectorRegistry, Counter, Gauge, Histogram, generate_latest

# The budget of a whole request is 20 ms and of a stage 1 to 10, so Prometheus' default buckets would show nothing.
BUCKETS_S = (0.001, 0.002, 0.003, 0.005, 0.0075, 0.01, 0.015, 0.02, 0.03, 0.04, 0.05, 0.1, 0.25, 1.0)

__all__ = ["CONTENT_TYPE_LATEST", "Metrics"]


class Metrics:
    """One registry of its own, so that two services in one process (as in tests) do not mix their counts."""

    def __init__(self, queue_depth: Callable[[], float]) -> None:
        self.registry = CollectorRegistry()
        self._stages = Histogram(
            "physnet_stage_seconds",
            "Wall time of each stage of a request.",
            ("stage",),
            buckets=BUCKETS_S,
            registry=self.registry,
        )
        self._requests = Counter(
            "physnet_requests",
            "Requests by wire, route and outcome (`ok` or the code of the error).",
            ("wire", "route", "code"),
            registry=self.registry,
        )
        self._seconds = Histogram(
            "physnet_request_seconds",
            "Time from the first byte of a request to the last of its reply.",
            ("wire", "route"),
            buckets=BUCKETS_S,
            registry=self.registry,
        )
        depth = Gauge("physnet_queue_depth", "Requests that wait for the worker.", registry=self.registry)
        depth.set_function(queue_depth)
        self._ready = Gauge("physnet_ready", "1 once the models are loaded and warmed up.", registry=self.registry)
        self._models = Gauge("physnet_model_info", "The models served.", ("name", "version"), registry=self.registry)

    def ready(self, models: Mapping[str, str]) -> None:
        """The service now answers with these models (name to version)."""
        self._ready.set(1)
        for name, version in models.items():
            self._models.labels(name, version).set(1)

    def stages(self, timing_ms: Mapping[str, float]) -> None:
        """Count the stage timings of one reply."""
        for stage, elapsed_ms in timing_ms.items():
            self._stages.labels(stage).observe(elapsed_ms * 1e-3)

    def request(self, wire: str, route: str, code: str, elapsed_s: float) -> None:
        """Count one request."""
        self._requests.labels(wire, route, code).inc()
        self._seconds.labels(wire, route).observe(elapsed_s)

    def exposition(self) -> bytes:
        """Prometheus' text format."""
        return generate_latest(self.registry)
