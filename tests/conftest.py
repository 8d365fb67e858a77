"""Fixtures that need a running service."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Queue
from typing import TextIO

import pytest

ROOT = Path(__file__).resolve().parents[1]


@dataclass
class LiveService:
    """`physnet serve` as its own process, with the shipped models, on ports it picked itself."""

    url: str
    grpc: str
    ready_line: str
    process: subprocess.Popen[str]
    log: Path

    def logged(self) -> str:
        return self.log.read_text("utf-8")


def start_service(log: Path, *arguments: str, timeout_s: float = 120.0) -> LiveService:
    """Start the service and wait for its ready line, in a fresh checkout until its kernels are compiled.

    Fails with the service's log where no line comes.
    """
    # The settings of whoever runs the tests are not the ones under test, but for models that are not shipped yet.
    kept = ("PHYSNET_MODELS",)
    environment = {key: value for key, value in os.environ.items() if not key.startswith("PHYSNET_") or key in kept}
    command = [sys.executable, "-m", "service", "serve", "--http-port", "0", "--grpc-port", "0", *arguments]
    with log.open("w") as errors:
        process = subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=subprocess.PIPE, stderr=errors, text=True
        )
    assert process.stdout is not None
    line = _first_line(process.stdout, timeout_s)
    if not line.startswith("ready http="):
        process.kill()
        process.wait()
        process.stdout.close()
        pytest.fail(f"no ready line but {line!r}; log:\n{log.read_text('utf-8')}")
    http, grpc = (line.split(f"{wire}=")[1].split()[0] for wire in ("http", "grpc"))
    return LiveService(f"http://{http}", grpc, line.rstrip("\n"), process, log)


def stop_service(service: LiveService, timeout_s: float = 15.0) -> int:
    """SIGTERM; returns the exit code."""
    service.process.send_signal(signal.SIGTERM)
    try:
        return service.process.wait(timeout_s)
    finally:
        service.process.kill()
        if service.process.stdout is not None:
            service.process.stdout.close()


def _first_line(stream: TextIO, timeout_s: float) -> str:
    lines: Queue[str] = Queue()
    threading.Thread(target=lambda: lines.put(stream.readline()), daemon=True).start()
    try:
        return lines.get(timeout=timeout_s)
    except Empty:
        return ""


@pytest.fixture(scope="session")
def live_service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LiveService]:
    """One real service for the whole run; it must still be alive at its end, whatever it was sent."""
    service = start_service(tmp_path_factory.mktemp("live") / "service.log")
    yield service
    assert service.process.poll() is None, f"the service died:\n{service.logged()}"
    assert stop_service(service) == 0
