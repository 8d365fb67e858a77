"""The generator against the real application around a predictor that takes as long as a test says."""

import asyncio
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from statistics import median

import pytest

from service.bench.open_loop import Measured, closed_loop, open_loop
from service.bench.picture import picture
from service.bench.question import sample_question
from service.bench.report import machine, run_document, table
from service.bench.targets import TARGETS, make_target
from service.core.errors import EmptyObject
from service.core.messages import DeformRequest, Observation
from tests.service.fakes import FakePredictor, Running, running

WORK_S = 0.02


@pytest.fixture(scope="module")
def service() -> Iterator[Running]:
    with running(FakePredictor(lambda request: time.sleep(WORK_S))) as found:
        yield found


def measure(
    service: Running, target: str, rate_hz: float, questions: int, clients: int = 1, loads: int = 1
) -> Measured:
    address = service.url.removeprefix("http://")
    question = sample_question(loads)
    targets = [make_target(target, address, service.grpc, question) for _ in range(clients)]
    return asyncio.run(open_loop(targets, rate_hz, questions / rate_hz))


@pytest.mark.parametrize("target", TARGETS)
def test_every_wire_asks_the_same_and_times_the_whole_reply(service: Running, target: str) -> None:
    measured = measure(service, target, rate_hz=10.0, questions=4, loads=3)
    # On a machine with much else to do a stream may skip.
    assert measured.outcomes["ok"] + measured.outcomes["skipped"] == 4
    assert measured.latency.percentile(1.0) > 1e3 * WORK_S
    asked = service.predictor.asked[-1]
    assert isinstance(asked.source, Observation)
    assert (asked.source.intrinsics.width, asked.source.depth.encoding) == (640, "png16")
    assert len({tuple(load.force_n) for load in asked.loads}) == 3
    assert asked.outputs == {"reconstruction", "deformed"}
    assert {"parse", "queue", "encode", "total"} <= measured.stages_ms.keys()


def test_a_stream_that_is_asked_for_too_much_skips_and_stays_fresh(service: Running) -> None:
    measured = measure(service, "grpc-stream", rate_hz=200.0, questions=60)
    assert measured.outcomes["ok"] + measured.outcomes["skipped"] == 60
    # Client and service share this process: how many frames overtake each other depends on what else the machine does.
    assert measured.outcomes["skipped"] > 0
    # One with the worker, one waiting: what is answered has waited for one other, in a queue it would have for twenty.
    # Held against what the rest of the same answer took, as all takes longer on a busy machine.
    stages = zip(measured.stages_ms["queue"], measured.stages_ms["total"], strict=True)
    assert median(queue_ms / (total_ms - queue_ms) for queue_ms, total_ms in stages) < 4.0


def test_unary_calls_wait_for_each_other_and_are_counted_from_when_they_were_due(service: Running) -> None:
    measured = measure(service, "grpc", rate_hz=100.0, questions=12)
    assert measured.outcomes == {"ok": 12}
    # Due every 10 ms, answered every 20: the last one has waited for the eleven before it.
    assert measured.latency.largest_ms > 1e3 * 0.5 * 12 * WORK_S


def test_clients_are_counted_one_by_one(service: Running) -> None:
    measured = measure(service, "grpc-stream", rate_hz=5.0, questions=3, clients=2)
    assert measured.outcomes["ok"] + measured.outcomes["skipped"] == 6
    assert measured.per_client[0] > 0 and measured.per_client[1] > 0
    assert measured.per_client.total() == measured.outcomes["ok"]


@pytest.mark.parametrize("target", TARGETS)
def test_refusals_are_counted_by_their_code(target: str) -> None:
    def refuse(request: DeformRequest) -> None:
        raise EmptyObject("nothing there")

    with running(FakePredictor(refuse)) as service:
        measured = measure(service, target, rate_hz=20.0, questions=3)
    code = "invalid_argument" if target == "grpc" else "empty_object"
    assert measured.outcomes[code] + measured.outcomes["skipped"] == 3
    document = run_document(measured)
    assert (document["answered"], document["failed"]) == (0, measured.outcomes[code])
    assert document["latency_ms"]["p50"] is None
    assert f"{code} {measured.outcomes[code]}" in "\n".join(table(document))


def test_a_closed_loop_waits_for_each_answer(service: Running) -> None:
    address = service.url.removeprefix("http://")
    measured = asyncio.run(closed_loop(make_target("http-json", address, service.grpc, sample_question()), 3))
    assert measured.outcomes == {"ok": 3}
    assert measured.elapsed_s > 3 * WORK_S


def test_what_was_measured_is_written_and_drawn(service: Running) -> None:
    measured = measure(service, "grpc-stream", rate_hz=100.0, questions=20)
    text = "\n".join(table(run_document(measured)))
    assert "20 asked" in text and "p99.9" in text
    assert machine()["cores"] >= 1
    drawing = ElementTree.fromstring(picture(measured, "a <title> & more"))
    circles = [element for element in drawing.iter() if element.tag.endswith("circle")]
    assert len(circles) == 20
    assert any("a <title> & more" in (element.text or "") for element in drawing.iter())


def test_an_empty_run_can_be_drawn() -> None:
    ElementTree.fromstring(picture(Measured(), "nothing"))
