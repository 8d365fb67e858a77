"""The bare time of what the pipeline cannot do without: its networks, and the prior that the second starts from."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np

from service.api import convert
from service.bench.question import BenchQuestion
from service.core.arrays import Occupancy
from service.core.condition import Condition
from service.core.lookup import Inside
from service.inference.deformation import Prior
from service.inference.registry import load_models
from service.pipeline import Pipeline
from service.settings import Settings


class BareGraphs:
    """Every call of a network that one question makes, with the very inputs it has there, to be made again alone.

    Args:
        settings: Models and threads, those of the service it is compared with.
        question: What is asked.
    """

    def __init__(self, settings: Settings, question: BenchQuestion) -> None:
        models = load_models(settings.models, settings.threads)
        pipeline = Pipeline(models.reconstruction, models.deformation)
        body = convert.parse_body(question.json)
        request = convert.deform_request(body, settings.max_loads)
        self._calls: dict[str, list[Callable[[], object]]] = {}
        with _recorded(models, self._calls):
            pipeline.predict(request)
        for name in list(self._calls):
            self.time_ms(name)

    @property
    def names(self) -> tuple[str, ...]:
        """`reconstruction`, `deformation`, and `prior` with its set-up for the body."""
        return tuple(self._calls)

    def time_ms(self, name: str) -> float:
        """Wall time of one of them, once."""
        began = time.perf_counter()
        for call in self._calls[name]:
            call()
        return 1e3 * (time.perf_counter() - began)

    def medians_ms(self, repeats: int) -> dict[str, float]:
        """Median wall time of each, taken in turns."""
        times: dict[str, list[float]] = {name: [] for name in self._calls}
        for _ in range(repeats):
            for name, found in times.items():
                found.append(self.time_ms(name))
        return {name: float(np.median(found)) for name, found in times.items()}


class _Recorder:
    """A session that remembers what it was asked."""

    def __init__(self, session: Any, calls: list[Callable[[], object]]) -> None:
        self._session = session
        self._calls = calls

    def run(self, names: Any, feeds: dict[str, np.ndarray]) -> Any:
        kept = {name: np.array(value) for name, value in feeds.items()}
        self._calls.append(lambda: self._session.run(names, kept))
        return self._session.run(names, feeds)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)


@contextmanager
def _recorded(models: Any, calls: dict[str, list[Callable[[], object]]]) -> Iterator[None]:
    """While it lasts, both networks and the prior's solve leave what they are asked in `calls`."""
    deformation = models.deformation
    sessions = ((models.reconstruction, "_session"), (deformation, "_encoder"), (deformation, "_session"))
    for network, name in sessions:
        recorder = _Recorder(getattr(network, name), calls.setdefault(network.manifest.kind, []))
        setattr(network, name, recorder)
    solve: Callable[..., Prior] = deformation.prior

    def recorded(rest: Occupancy, conditions: Sequence[Condition], inside: Inside | None = None) -> Prior:
        # A body of its own: the last one's factor is kept, but a new frame shows a body that nobody has solved for.
        calls.setdefault("prior", []).append(lambda: solve(rest.copy(), conditions).backward())
        return solve(rest, conditions, inside)

    deformation.prior = recorded
    try:
        yield
    finally:
        del deformation.prior
        for network, name in sessions:
            setattr(network, name, getattr(network, name)._session)
