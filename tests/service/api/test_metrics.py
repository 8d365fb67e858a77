"""What Prometheus reads, and whether the dashboard and the alerts ask for what is there."""

from __future__ import annotations

import json
import re
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import grpc
import httpx
import pytest
from prometheus_client.parser import text_string_to_metric_families

from service.api.metrics import BUCKETS_S, STAGES
from service.api.status import meanings
from tests.service import rpc_client
from tests.service.box_scene import BoxScene
from tests.service.fakes import FakePredictor, running

ROOT = Path(__file__).resolve().parents[3]
DASHBOARD = ROOT / "deploy" / "grafana" / "physnet.json"
ALERTS = ROOT / "deploy" / "prometheus" / "alerts.yml"
SCENE = BoxScene(width=32, height=24, focal_px=30.0)

Sample = tuple[str, dict[str, str], float]

OF_PROMETHEUS = {"instance", "job"}
"""Labels that every series has once it is scraped."""


@pytest.fixture(scope="module")
def samples() -> list[Sample]:
    """Of a service that has answered, refused and skipped, over both wires."""
    gate, entered = threading.Event(), threading.Event()

    def react(request: Any) -> None:
        if request.material.young_modulus_pa == 5.0:
            entered.set()
            assert gate.wait(20)

    slow = rpc_client.message(SCENE.request(material={"young_modulus_pa": 5.0, "poisson_ratio": 0.3}))
    quick = rpc_client.message(SCENE.request())
    with running(FakePredictor(react)) as service, grpc.insecure_channel(service.grpc) as channel:
        stub = rpc_client.stub(channel)
        stub.Deform(quick)
        httpx.post(f"{service.url}/v1/deform", json=SCENE.request())
        httpx.post(f"{service.url}/v1/deform", json={})

        def frames() -> Iterator[Any]:
            yield rpc_client.pb.DeformStreamRequest(frame_id=1, request=slow)
            assert entered.wait(20)
            for number in (2, 3):
                yield rpc_client.pb.DeformStreamRequest(frame_id=number, request=quick)
            skipped.wait(20)
            gate.set()

        skipped = threading.Event()
        for response in stub.DeformStream(frames()):
            if response.WhichOneof("outcome") == "skipped":
                skipped.set()
        text = httpx.get(f"{service.url}/metrics").text
    return [
        (sample.name, dict(sample.labels), sample.value)
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    ]


def value(samples: list[Sample], metric: str, /, **labels: str) -> float:
    (found,) = [sample[2] for sample in samples if sample[:2] == (metric, labels)]
    return found


def test_every_stage_has_its_histogram_with_buckets_where_its_times_are(samples):
    assert sum(1e-3 <= bucket <= 50e-3 for bucket in BUCKETS_S) >= 12
    for stage in STAGES:
        buckets = [
            labels["le"] for name, labels, _ in samples
            if name == "physnet_stage_seconds_bucket" and labels["stage"] == stage
        ]  # fmt: skip
        assert [float(bucket) for bucket in buckets] == [*BUCKETS_S, float("inf")]
    # Two answered calls and two answered frames, each of 2 ms.
    assert value(samples, "physnet_stage_seconds_count", stage="deform") == 4
    assert value(samples, "physnet_stage_seconds_sum", stage="deform") == pytest.approx(0.008)


def test_outcomes_are_counted_by_wire_and_reason(samples):
    frame = "/physnet.v1.DeformationService/DeformStream#frame"
    assert value(samples, "physnet_requests_total", wire="grpc", route=frame, code="ok") == 2
    assert value(samples, "physnet_requests_total", wire="grpc", route=frame, code="skipped") == 1
    assert value(samples, "physnet_skipped_total") == 1
    assert value(samples, "physnet_rejected_total", wire="http", reason="invalid_request") == 1
    # A reason that has not come up is a zero, so that an alert on it has something to compare with.
    reasons = {labels["reason"] for name, labels, _ in samples if name == "physnet_rejected_total"}
    assert reasons == set(meanings())
    assert value(samples, "physnet_rejected_total", wire="grpc", reason="overloaded") == 0
    # Latencies are of answers: a refusal is quick and would flatter them.
    assert value(samples, "physnet_request_seconds_count", wire="http", route="/v1/deform") == 1


def test_the_state_of_the_service_is_there(samples):
    assert value(samples, "physnet_ready") == 1
    assert value(samples, "physnet_queue_depth") == 0
    assert value(samples, "physnet_model_info", kind="deformation", name="fake", version="9.9.9") == 1
    for name in ("physnet_reconstructions_kept", "physnet_reconstructions_kept_bytes"):
        assert value(samples, name) == 0
    for outcome in ("hit", "gone"):
        assert value(samples, "physnet_reconstructions_asked_total", outcome=outcome) == 0
    assert value(samples, "process_resident_memory_bytes") > 1e6


def queries() -> list[tuple[str, str, str]]:
    """(where, query, legend) of the dashboard and the alerts."""
    yaml = pytest.importorskip("yaml", reason="reads the alerts")
    found = []
    for panel in json.loads(DASHBOARD.read_text("utf-8"))["panels"]:
        assert panel["targets"] and panel["description"], panel["title"]
        found += [(panel["title"], target["expr"], target["legendFormat"]) for target in panel["targets"]]
    for group in yaml.safe_load(ALERTS.read_text("utf-8"))["groups"]:
        for rule in group["rules"]:
            summary = rule["annotations"]["summary"].replace("$labels.", "").replace(" ", "")
            found.append((rule["alert"], rule["expr"], summary))
    return found


def selectors(node: Any, promql: Any) -> Iterator[tuple[Any, set[str]]]:
    """Every selector in a query, with the labels that something around it groups by."""
    match node:
        case promql.VectorSelector():
            yield node, set()
        case promql.MatrixSelector():
            yield node.vector_selector, set()
        case promql.AggregateExpr():
            by = set(node.modifier.labels) if node.modifier is not None else set()
            yield from ((selector, labels | by) for selector, labels in selectors(node.expr, promql))
        case promql.Call():
            for argument in node.args:
                yield from selectors(argument, promql)
        case promql.BinaryExpr():
            yield from selectors(node.lhs, promql)
            yield from selectors(node.rhs, promql)
        case promql.ParenExpr() | promql.UnaryExpr():
            yield from selectors(node.expr, promql)


def matches(matcher: Any, labels: dict[str, str], promql: Any) -> bool:
    found = labels.get(matcher.name, "")
    match matcher.op:
        case promql.MatchOp.Equal:
            return found == matcher.value
        case promql.MatchOp.NotEqual:
            return found != matcher.value
    agrees = re.fullmatch(matcher.value, found) is not None
    return agrees if matcher.op == promql.MatchOp.Re else not agrees


def problems(query: str, samples: list[Sample]) -> list[str]:
    """What in a query there is nothing for."""
    promql = pytest.importorskip("promql_parser", reason="reads the queries")
    filled = query.replace("$__rate_interval", "1m").replace("$instance", ".*")
    found = []
    for selector, grouped in selectors(promql.parse(filled), promql):
        if selector.name == "up":
            continue
        series = [labels for name, labels, _ in samples if name == selector.name]
        if not series:
            found.append(f"no metric {selector.name}")
            continue
        ours = [matcher for matcher in selector.matchers.matchers if matcher.name not in OF_PROMETHEUS]
        for label in {matcher.name for matcher in ours} | grouped:
            if label not in OF_PROMETHEUS and not any(label in labels for labels in series):
                found.append(f"{selector.name} has no label {label}")
        if not any(all(matches(matcher, labels, promql) for matcher in ours) for labels in series):
            found.append(f"no series of {selector.name} is {[str(matcher) for matcher in ours]}")
    return found


def test_every_query_of_the_dashboard_and_the_alerts_finds_what_it_asks_for(samples):
    asked = queries()
    assert len(asked) > 25
    for where, query, _ in asked:
        assert not problems(query, samples), (where, query)


def test_legends_name_labels_that_are_left_after_grouping():
    for where, query, legend in queries():
        grouped = {label.strip() for labels in re.findall(r"by \(([^)]*)\)", query) for label in labels.split(",")}
        for label in re.findall(r"{{(\w+)}}", legend):
            assert label in grouped | OF_PROMETHEUS, (where, label)


@pytest.mark.parametrize(
    "query",
    [
        "physnet_stages_seconds_count",
        'physnet_requests_total{outcome="ok"}',
        'rate(physnet_requests_total{code="fine"}[1m])',
        "sum by (stages) (rate(physnet_stage_seconds_sum[1m]))",
        'physnet_stage_seconds_count{stage!~".*"} / 2',
    ],
)
def test_the_check_sees_a_query_for_what_is_not_there(samples, query):
    assert problems(query, samples)


def test_every_metric_is_explained(samples):
    page = (ROOT / "docs" / "operations.md").read_text("utf-8")
    for name in {name for name, _, _ in samples if name.startswith("physnet_")}:
        assert re.sub(r"_(bucket|count|sum|created)$", "", name) in page, name
