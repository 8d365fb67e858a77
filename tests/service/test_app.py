"""The service as a whole: when it is ready, how it says so, and how it ends."""

from __future__ import annotations

import ctypes
import os
import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx
import pytest

from service.app import build_pipeline
from service.core.errors import ModelMismatch
from service.settings import Settings
from tests.service.box_scene import BoxScene
from tests.service.fakes import FakePredictor, running

ROOT = Path(__file__).resolve().parents[2]
SCENE = BoxScene(width=32, height=24, focal_px=30.0)


def test_one_ready_line_names_the_port_that_was_picked():
    with running(FakePredictor()) as service:
        (line,) = service.ready_lines
        assert re.fullmatch(r"ready http=127\.0\.0\.1:[1-9]\d* grpc=127\.0\.0\.1:[1-9]\d*", line)
        assert httpx.get(f"{service.url}/readyz").json() == {"status": "ready"}
        assert service.stop() == 0


def test_it_is_alive_but_not_ready_while_the_models_load(monkeypatch):
    loading, go_on = threading.Event(), threading.Event()
    seen: dict[str, httpx.Response] = {}

    def load() -> None:
        loading.set()
        assert go_on.wait(10)

    # The port is only announced later, so it is taken from the socket the service listens on.
    from service import app

    ports: list[int] = []
    real = app._listen

    def listen(host: str, port: int):
        listener = real(host, port)
        ports.append(listener.getsockname()[1])
        return listener

    monkeypatch.setattr(app, "_listen", listen)

    def look() -> None:
        assert loading.wait(10)
        url = f"http://127.0.0.1:{ports[0]}"
        for path in ("/healthz", "/readyz", "/v1/models"):
            seen[path] = httpx.get(url + path)
        seen["/v1/deform"] = httpx.post(f"{url}/v1/deform", json=SCENE.request())
        go_on.set()

    looker = threading.Thread(target=look)
    looker.start()
    with running(FakePredictor(), load) as service:
        looker.join()
        assert seen["/healthz"].status_code == 200
        for path in ("/readyz", "/v1/models", "/v1/deform"):
            assert seen[path].status_code == 503
            assert seen[path].json()["code"] == "overloaded"
            assert "retry-after" in seen[path].headers
        assert httpx.post(f"{service.url}/v1/deform", json=SCENE.request()).status_code == 200


def test_models_that_do_not_load_end_the_service_with_1(caplog):
    def fail() -> None:
        raise ModelMismatch("models/x does not fit its manifest")

    with running(FakePredictor(), fail) as service:
        assert service.ready_lines == []
        assert service.stop() == 1
    assert any("does not fit its manifest" in record.getMessage() for record in caplog.records)


def test_an_empty_models_directory_is_a_mismatch(tmp_path):
    with pytest.raises(ModelMismatch):
        build_pipeline(Settings(models=tmp_path, threads=1))


def test_a_request_in_flight_is_answered_before_the_end():
    entered, gate = threading.Event(), threading.Event()

    def hold(_) -> None:
        entered.set()
        assert gate.wait(10)

    replies: list[httpx.Response] = []
    with running(FakePredictor(hold)) as service:
        asking = threading.Thread(
            target=lambda: replies.append(httpx.post(f"{service.url}/v1/deform", json=SCENE.request(), timeout=10))
        )
        asking.start()
        assert entered.wait(10)
        codes: list[int] = []
        stopping = threading.Thread(target=lambda: codes.append(service.stop()))
        stopping.start()
        time.sleep(0.2)
        gate.set()
        asking.join()
        stopping.join()
    assert replies[0].status_code == 200
    assert codes == [0]


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_with_0_and_only_the_ready_line_on_stdout(number):
    program = (
        "import service.app as app\n"
        "from tests.service.fakes import fake_manifest, FakePredictor\n"
        "served = app.Served(FakePredictor(), [fake_manifest()])\n"
        "app.serve.__defaults__ = (lambda settings: served, *app.serve.__defaults__[1:])\n"
        "from service.__main__ import main\n"
        "raise SystemExit(main(['serve', '--http-port', '0', '--grpc-port', '0']))\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={key: value for key, value in os.environ.items() if not key.startswith("PHYSNET_")},
    )  # fmt: skip
    try:
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("ready http="), process.communicate(timeout=5)
        url = f"http://{line.split('http=')[1].split()[0]}"
        # A connection kept open must not hold up the end.
        with httpx.Client() as client:
            assert client.post(f"{url}/v1/deform", json=SCENE.request()).status_code == 200
            process.send_signal(number)
            out, errors = process.communicate(timeout=15)
    finally:
        process.kill()
    assert process.returncode == 0, errors
    assert out == ""
    assert "Traceback" not in errors


@pytest.mark.skipif(not hasattr(ctypes.CDLL(None), "mallopt"), reason="the C library is not glibc")
def test_memory_that_an_answer_freed_serves_the_next_one():
    """Pages that the system has to give anew, for a field of displacements that is made and thrown away ten times."""
    program = (
        "import resource, numpy as np; from service.app import keep_freed_memory; keep_freed_memory()\n"
        "def faults(): return resource.getrusage(resource.RUSAGE_SELF).ru_minflt\n"
        "np.ones((3, 64, 64, 64), np.float32); before = faults()\n"
        "for _ in range(10): np.ones((3, 64, 64, 64), np.float32)\n"
        "print(faults() - before)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, cwd=ROOT)
    assert int(done.stdout) < 100
