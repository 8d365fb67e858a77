"""A service of our own to ask: started, watched and ended."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

START_TIMEOUT_S = 120.0
MEMORY_PERIOD_S = 1.0


class ServiceFailed(Exception):
    """The service did not start, or has ended; the text is the end of its log."""


@dataclass
class RunningService:
    """Attributes:
    http: HOST:PORT.
    grpc: HOST:PORT.
    ready_s: From the start of the process until its ready line; NaN for a service that was there already.
    process_id: 0 for one that is not ours to watch.
    memory: (seconds since it was ready, resident MiB).
    """

    http: str
    grpc: str
    ready_s: float = float("nan")
    process_id: int = 0
    memory: list[tuple[float, float]] = field(default_factory=list)

    def resident_mib(self) -> float:
        """Resident memory now; NaN where it cannot be read."""
        return _status_mib(self.process_id, "VmRSS") if self.process_id else float("nan")

    def peak_mib(self) -> float:
        """The most there ever was; NaN where it cannot be read."""
        return _status_mib(self.process_id, "VmHWM") if self.process_id else float("nan")

    def cpu_s(self) -> float:
        """Processor time of the process so far, over all cores; NaN where it cannot be read."""
        try:
            fields = Path(f"/proc/{self.process_id}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return float("nan")
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


@contextlib.contextmanager
def running_service(*options: str) -> Iterator[RunningService]:
    """`physnet serve` on free ports, with further options, in a process of its own.

    Raises:
        ServiceFailed: It did not become ready.
    """
    command = [sys.executable, "-m", "service", "serve", "--http-port", "0", "--grpc-port", "0", *options]
    started = time.perf_counter()
    with tempfile.TemporaryFile("w+") as log:
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        try:
            line = _first_line(process)
            if not line.startswith("ready "):
                raise ServiceFailed(f"the service did not become ready: {_tail(log)}")
            address = dict(part.split("=", 1) for part in line.split()[1:])
            service = RunningService(
                address["http"], address["grpc"], time.perf_counter() - started, process.pid
            )
            done = threading.Event()
            watcher = threading.Thread(target=_watch, args=(service, done), name="memory", daemon=True)
            watcher.start()
            yield service
            done.set()
            watcher.join()
            if process.poll() is not None:
                raise ServiceFailed(f"the service ended with code {process.returncode}: {_tail(log)}")
        finally:
            process.terminate()
            try:
                process.wait(timeout=20.0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            assert process.stdout is not None
            process.stdout.close()


def _first_line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    # Without it a service that hangs would hang us.
    timer = threading.Timer(START_TIMEOUT_S, process.kill)
    timer.start()
    try:
        return process.stdout.readline()
    finally:
        timer.cancel()


def _watch(service: RunningService, done: threading.Event) -> None:
    began = time.perf_counter()
    while not done.is_set():
        service.memory.append((time.perf_counter() - began, service.resident_mib()))
        done.wait(MEMORY_PERIOD_S)


def _tail(log: IO[str]) -> str:
    log.seek(0)
    return log.read()[-2000:].strip() or "it said nothing"


def _status_mib(process_id: int, name: str) -> float:
    try:
        lines = Path(f"/proc/{process_id}/status").read_text().splitlines()
        return next(int(line.split()[1]) / 1024 for line in lines if line.startswith(f"{name}:"))
    except (OSError, StopIteration):
        return float("nan")
