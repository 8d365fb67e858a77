"""How long the client waits: for a full queue, until a deadline, and for a service that is being started."""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest

from service.client import DeadlineExceeded, Overloaded, PhysNetClient, Result, ServiceUnreachable
from tests.service.client.kinds import CAMERA, KINDS, ONCE, PUSH, SCENE, SOFT, check, url
from tests.service.client.ports import free_ports
from tests.service.fakes import FakePredictor, running
from tests.service.waiting import metric, queue_depth, until


@pytest.mark.parametrize("kind", KINDS)
def test_a_full_queue_is_tried_again_when_it_says_so(kind):
    """The first is with the worker, the second fills the queue; the third is refused, waits, and is answered."""
    gate = threading.Semaphore(0)
    entered = threading.Semaphore(0)

    def hold(_: Any) -> None:
        entered.release()
        assert gate.acquire(timeout=20)

    with running(FakePredictor(hold), queue_size=1) as service:
        answers: list[Result] = []

        def ask() -> None:
            with PhysNetClient(service.url, retry=ONCE) as other:
                answers.append(other.deform(SCENE.counts(), CAMERA, PUSH, SOFT))

        def release_once_refused(before: float) -> None:
            assert until(lambda: metric(service.url, 'physnet_rejected_total{reason="overloaded"') > before)
            gate.release(5)

        threads = [threading.Thread(target=ask) for _ in range(2)]
        threads[0].start()
        assert entered.acquire(timeout=10)
        threads[1].start()
        assert until(lambda: queue_depth(service.url) == 1)
        with KINDS[kind](url(service, kind), retry=ONCE) as client:
            began = time.monotonic()
            with pytest.raises(Overloaded) as caught:
                client.deform(SCENE.counts(), CAMERA, PUSH, SOFT)
            assert caught.value.retry_after_s > 0.0
            assert time.monotonic() - began < 5.0
        with KINDS[kind](url(service, kind), timeout_s=20.0) as client:
            told = metric(service.url, 'physnet_rejected_total{reason="overloaded"')
            threading.Thread(target=release_once_refused, args=(told,)).start()
            began = time.monotonic()
            check(client.deform(SCENE.counts(), CAMERA, PUSH, SOFT), service.predictor.asked[0])
            # It came back after the time that it was told, not at once.
            assert time.monotonic() - began >= caught.value.retry_after_s * 0.99
        for thread in threads:
            thread.join(timeout=10)
    assert len(answers) == 2


@pytest.mark.parametrize("kind", KINDS)
def test_a_deadline_ends_the_call_and_the_service_hears_of_it(kind):
    gate = threading.Event()
    gate.set()

    def hold(_: Any) -> None:
        gate.wait(20)

    with running(FakePredictor(hold)) as service, KINDS[kind](url(service, kind)) as client:
        # The connection is there, so that the deadline is that of a question and its answer.
        client.deform(SCENE.counts(), CAMERA, PUSH, SOFT)
        gate.clear()
        began = time.monotonic()
        with pytest.raises(DeadlineExceeded):
            client.deform(SCENE.counts(), CAMERA, PUSH, SOFT, timeout_s=0.4)
        assert 0.3 < time.monotonic() - began < 5.0
        # One that waits behind it has gone from the queue before it was computed.
        with pytest.raises(DeadlineExceeded):
            client.deform(SCENE.counts(), CAMERA, PUSH, SOFT, timeout_s=0.4)
        assert until(lambda: queue_depth(service.url) == 0)
        gate.set()
    assert len(service.predictor.asked) == 2


@pytest.mark.parametrize("kind", ["http", "grpc async"])
def test_a_service_that_is_being_started_is_waited_for(kind):
    built = threading.Event()
    ready = {}
    ports = free_ports()

    def serve() -> None:
        with running(FakePredictor(), build=lambda: built.wait(10), http_port=ports[0], grpc_port=ports[1]) as service:
            ready["service"] = service
            stop.wait(20)

    stop = threading.Event()
    thread = threading.Thread(target=serve)
    thread.start()
    try:
        wire, port = ("grpc", ports[1]) if kind.startswith("grpc") else ("http", ports[0])
        with KINDS[kind](f"{wire}://127.0.0.1:{port}") as client:
            # The one error after a pause that would have lasted beyond the deadline, the other without.
            with pytest.raises((DeadlineExceeded, Overloaded, ServiceUnreachable)):
                client.wait_until_ready(timeout_s=0.5)
            built.set()
            client.wait_until_ready(timeout_s=20.0)
            check(client.deform(SCENE.counts(), CAMERA, PUSH, SOFT), ready["service"].predictor.asked[-1])
    finally:
        built.set()
        stop.set()
        thread.join(timeout=20)
