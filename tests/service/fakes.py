"""A predictor without networks, for tests of the wire: what the service does before and after a prediction."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np

from service.app import Served, serve
from service.core.grids import Grid
from service.core.manifest import Manifest
from service.core.messages import DeformRequest, DeformResult, LoadResult, Observation
from service.settings import Settings


def fake_manifest() -> Manifest:
    return Manifest(
        name="fake", version="9.9.9", kind="deformation", graph="model.onnx", files={"model.onnx": "0"}, inputs=(),
        outputs=(), grid_contract="1", condition_contract="1", threshold=0.5, condition_range={}, configuration={},
        run="none", dataset={}, commit="none", parity=0.0, evaluation={},
    )  # fmt: skip


_CENTRES = (np.indices((64, 64, 64), dtype=np.float32) + 0.5) / 64
_DISTANCE = np.sqrt(((_CENTRES - 0.5) ** 2).sum(0))


def fake_result(request: DeformRequest) -> DeformResult:
    """A ball at rest, moved one voxel along x by each load; the n-th load moves n times as far."""
    centres, distance = _CENTRES, _DISTANCE
    probability = np.clip(1.0 - 2.0 * distance, 0.0, 1.0).astype(np.float32)
    rest = distance < 0.3
    loads = []
    for number, _ in enumerate(request.loads, start=1):
        deformed = np.roll(rest, number, axis=0)
        moved_m = np.zeros((3, np.count_nonzero(deformed)), np.float32)
        moved_m[0] = 0.003 * number
        loads.append(
            LoadResult(deformed, np.roll(probability, number, axis=0), moved_m, 0.003 * number, 0.002 * number,
                       0.01 * number, frozenset({"contact_snapped"}))
        )  # fmt: skip
    pose = np.eye(4)
    pose[:3, 3] = (-0.1, -0.1, 0.5)
    observed = rest & (centres[2] < 0.5) if isinstance(request.source, Observation) else None
    return DeformResult(
        grid=Grid(pitch_m=0.2 / 64, camera_from_grid=pose),
        observed=observed,
        reconstruction=rest,
        reconstruction_probability=probability,
        loads=tuple(loads),
        flags=frozenset({"object_cut_by_border"}),
        model_name="fake",
        model_version="9.9.9",
        timing_ms={"decode": 1.0, "deform": 2.0, "total": 3.5},
    )


@dataclass
class FakePredictor:
    """Keeps what it was asked; `react` may raise, or block on an event the test holds."""

    react: Callable[[DeformRequest], None] = lambda request: None
    asked: list[DeformRequest] = field(default_factory=list)
    threads: set[str] = field(default_factory=set)

    def predict(self, request: DeformRequest) -> DeformResult:
        self.asked.append(request)
        self.threads.add(threading.current_thread().name)
        self.react(request)
        return fake_result(request)


@dataclass
class Running:
    """A service on a real socket."""

    url: str
    grpc: str
    predictor: FakePredictor
    stop: Callable[[], int]
    ready_lines: list[str]


@contextmanager
def running(
    predictor: FakePredictor, build: Callable[[], None] = lambda: None, **settings: object
) -> Iterator[Running]:
    """The real application around a fake predictor, in a thread of its own; `build` runs where models would load.

    It has one worker unless asked for more, so that what waits behind what is the same on every machine.
    """
    lines: list[str] = []
    announced = threading.Event()
    started = threading.Event()
    state: dict[str, object] = {}

    def announce(line: str) -> None:
        lines.append(line)
        announced.set()

    def make(_: Settings) -> Served:
        build()
        return Served(predictor, [fake_manifest()])

    async def main() -> int:
        stop = asyncio.Event()
        state["loop"], state["stop"] = asyncio.get_running_loop(), stop
        started.set()
        try:
            chosen = Settings(**{"http_port": 0, "grpc_port": 0, "workers": 1} | settings)  # type: ignore[arg-type]
            return await serve(chosen, make, stop, announce)
        finally:
            announced.set()

    def target() -> None:
        state["code"] = asyncio.run(main())

    thread = threading.Thread(target=target, name="service")
    thread.start()

    def stop() -> int:
        if thread.is_alive():
            state["loop"].call_soon_threadsafe(state["stop"].set)  # type: ignore[attr-defined]
        thread.join(timeout=20)
        assert not thread.is_alive(), "the service did not stop"
        return int(state["code"])  # type: ignore[call-overload]

    try:
        assert started.wait(10)
        assert announced.wait(20)
        http, grpc = ((lines[0].split(f"{wire}=")[1].split()[0] if lines else "") for wire in ("http", "grpc"))
        yield Running(f"http://{http}", grpc, predictor, stop, lines)
    finally:
        stop()
