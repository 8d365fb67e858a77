"""Traces as a collector receives them: what belongs to what, and nothing at all where none is named."""

from __future__ import annotations

import itertools
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent import futures
from pathlib import Path
from typing import Any

import grpc
import httpx
import pytest

from service.api.tracing import NO_SPAN, NO_TRACER, make_tracer
from tests.service import rpc_client
from tests.service.box_scene import BoxScene
from tests.service.fakes import FakePredictor, running

trace_service = pytest.importorskip(
    "opentelemetry.proto.collector.trace.v1.trace_service_pb2", reason="needs physnet[tracing]"
)

ROOT = Path(__file__).resolve().parents[3]
SCENE = BoxScene(width=32, height=24, focal_px=30.0)
CALLER = "00-0af7651916cd43dd8448eb211c80319c-b7ad6b7169203331-01"
TRACE, PARENT = CALLER.split("-")[1:3]


class Collector:
    """Takes OTLP over gRPC, as the OpenTelemetry Collector does."""

    def __init__(self) -> None:
        self.spans: list[Any] = []
        self.service = ""
        self.came = threading.Event()
        self._server = grpc.server(futures.ThreadPoolExecutor(2))
        export = grpc.unary_unary_rpc_method_handler(
            self._export,
            request_deserializer=trace_service.ExportTraceServiceRequest.FromString,
            response_serializer=lambda message: message.SerializeToString(),
        )
        name = "opentelemetry.proto.collector.trace.v1.TraceService"
        self._server.add_generic_rpc_handlers((grpc.method_handlers_generic_handler(name, {"Export": export}),))
        self.endpoint = f"http://127.0.0.1:{self._server.add_insecure_port('127.0.0.1:0')}"
        self._server.start()

    def _export(self, request: Any, context: Any) -> Any:
        for resource in request.resource_spans:
            (self.service,) = [a.value.string_value for a in resource.resource.attributes if a.key == "service.name"]
            for scope in resource.scope_spans:
                self.spans.extend(scope.spans)
        self.came.set()
        return trace_service.ExportTraceServiceResponse()

    def stop(self) -> None:
        self._server.stop(None)

    def named(self, name: str) -> list[Any]:
        return [span for span in self.spans if span.name == name]

    def children(self, span: Any) -> list[Any]:
        found = [other for other in self.spans if other.parent_span_id == span.span_id]
        return sorted(found, key=lambda other: other.start_time_unix_nano)


@pytest.fixture(scope="module")
def collected() -> Iterator[Collector]:
    """One question on each wire, one refusal and one failure, of which the collector has heard."""
    collector = Collector()

    def react(request: Any) -> None:
        if request.material.young_modulus_pa == 666.0:
            raise RuntimeError("a bug")

    failing = SCENE.request(material={"young_modulus_pa": 666.0, "poisson_ratio": 0.3})
    with running(FakePredictor(react), tracing_endpoint=collector.endpoint) as service:
        with httpx.Client(base_url=service.url) as client, grpc.insecure_channel(service.grpc) as channel:
            client.post("/v1/deform", json=SCENE.request(), headers={"traceparent": CALLER, "X-Request-Id": "one"})
            client.post("/v1/deform", json={})
            client.post("/v1/deform", json=failing)
            client.get("/healthz")
            client.get("/metrics")
            stub, caller = rpc_client.stub(channel), (("traceparent", CALLER),)
            stub.Deform(rpc_client.message(SCENE.request()), metadata=caller)
            frame = rpc_client.pb.DeformStreamRequest(frame_id=7, request=rpc_client.message(SCENE.request()))
            list(stub.DeformStream(iter([frame]), metadata=caller))
        # What is not sent yet is sent before the service ends.
        assert service.stop() == 0
    assert collector.came.is_set()
    yield collector
    collector.stop()


def attributes(span: Any) -> dict[str, str]:
    return {attribute.key: attribute.value.string_value for attribute in span.attributes}


@pytest.mark.parametrize(
    "name",
    ["POST /v1/deform", "physnet.v1.DeformationService/Deform", "physnet.v1.DeformationService/DeformStream#frame"],
)
def test_a_question_goes_on_with_its_callers_trace_and_its_stages_fill_it(collected, name):
    span = next(span for span in collected.named(name) if span.trace_id.hex() == TRACE)
    assert collected.service == "physnet"
    assert span.parent_span_id.hex() == PARENT
    assert attributes(span)["physnet.code"] == "ok"
    stages = collected.children(span)
    assert [stage.name for stage in stages] == ["parse", "queue", "decode", "deform", "encode"]
    (deform,) = [stage for stage in stages if stage.name == "deform"]
    assert deform.end_time_unix_nano - deform.start_time_unix_nano == pytest.approx(2e6, rel=0.01)
    for before, after in itertools.pairwise(stages):
        assert before.end_time_unix_nano <= after.start_time_unix_nano + 1


def test_the_id_of_a_request_leads_to_its_trace(collected):
    spans = [span for span in collected.spans if attributes(span).get("physnet.request_id") == "one"]
    assert [span.trace_id.hex() for span in spans] == [TRACE]
    (frame,) = collected.named("physnet.v1.DeformationService/DeformStream#frame")
    assert attributes(frame)["physnet.frame_id"] == "7"


def test_a_refusal_is_no_failure_but_a_bug_is(collected):
    by_code = {attributes(span)["physnet.code"]: span for span in collected.named("POST /v1/deform")}
    assert set(by_code) == {"ok", "invalid_request", "internal"}
    failed, unset = 2, 0
    assert by_code["internal"].status.code == failed
    assert by_code["invalid_request"].status.code == unset
    # Without a caller's trace each has its own.
    assert len({span.trace_id for span in by_code.values()}) == 3


def test_probes_are_not_traced(collected):
    assert not [span for span in collected.spans if "healthz" in span.name or "metrics" in span.name]


def test_off_is_off():
    assert make_tracer(None, 1.0, "1") is NO_TRACER
    assert NO_TRACER.begin("anything", {}, {}) is NO_SPAN
    # Not a library's own hooks for it, but what would make and send spans.
    program = "import sys, service.app; print([name for name in sys.modules if name.startswith('opentelemetry.sdk')])"
    out = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, check=True, capture_output=True, text=True, timeout=120
    ).stdout
    assert out.strip() == "[]"


def test_a_collector_that_is_not_there_costs_no_request_and_no_stop():
    with running(FakePredictor(), tracing_endpoint="http://127.0.0.1:1", shutdown_grace_s=0.5) as service:
        assert httpx.post(f"{service.url}/v1/deform", json=SCENE.request()).status_code == 200
        assert service.stop() == 0
