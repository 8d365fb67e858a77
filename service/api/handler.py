"""The one way to an answer: every wire translates, then calls this."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping, Sequence
from typing import Any

from service.api.metrics import Metrics, State
from service.api.tracing import NO_TRACER, Span, Tracer
from service.core.errors import Overloaded
from service.core.manifest import Manifest
from service.core.messages import DeformRequest
from service.inference.graph import Graph
from service.reconstructions import Reconstructions
from service.scheduler import Answer, Place, Result, Scheduler, Then, as_it_is


class Handler:
    """Exists before the models do, so that a wire can say that it is not ready yet."""

    def __init__(self, tracer: Tracer = NO_TRACER) -> None:
        self.tracer = tracer
        self.metrics = Metrics(self._state)
        self._scheduler: Scheduler | None = None
        self._kept: Reconstructions[Any] | None = None
        self._manifests: tuple[Manifest, ...] = ()
        self._graphs: tuple[Graph, ...] = ()
        self._stopping = False

    @property
    def ready(self) -> bool:
        """Whether the models are loaded and warmed up, and the service is not being stopped."""
        return self._scheduler is not None and not self._stopping

    @property
    def manifests(self) -> tuple[Manifest, ...]:
        """Manifests of the models served; none before they are loaded."""
        return self._manifests

    @property
    def graphs(self) -> tuple[Graph, ...]:
        """The networks as they are; none before they are loaded."""
        return self._graphs

    def open(
        self,
        scheduler: Scheduler,
        manifests: Sequence[Manifest],
        graphs: Sequence[Graph] = (),
        kept: Reconstructions[Any] | None = None,
    ) -> None:
        """From here on requests are answered."""
        self._scheduler = scheduler
        self._kept = kept
        self._graphs = tuple(graphs)
        self._manifests = tuple(manifests)
        self.metrics.models(manifests)

    async def deform(self, request: DeformRequest, deadline: float, then: Then = as_it_is) -> Answer[Any]:
        """Answer one request with what `then` makes of the answer; see `Scheduler.submit`.

        Raises:
            Overloaded: The models are still being loaded, or the queue is full.
            PhysNetError: What the scheduler or the predictor raises.
        """
        return await self._opened().submit(request, deadline, then)

    def answered(self, timing_ms: Mapping[str, float], span: Span) -> None:
        """Trace the stages of an answer, which ends now, and count them once its reply is written."""
        span.stages(timing_ms)
        asyncio.get_running_loop().call_soon(self.metrics.stages, timing_ms)

    async def call(self, work: Callable[[], Result], deadline: float) -> Answer[Result]:
        """Do something else in a worker's turn; see `Scheduler.call`. Raises as `deform` does."""
        return await self._opened().call(work, deadline)

    def place(self) -> Place:
        """A place in the queue for one stream of frames.

        Raises:
            Overloaded: The models are still being loaded.
        """
        return self._opened().place()

    def _state(self) -> State:
        kept = self._kept
        return State(
            ready=self.ready,
            queue_depth=self._scheduler.queue_depth if self._scheduler else 0,
            kept=kept.entries if kept else 0,
            kept_bytes=kept.nbytes if kept else 0,
            hits=kept.hits if kept else 0,
            misses=kept.misses if kept else 0,
        )

    def _opened(self) -> Scheduler:
        if self._scheduler is None:
            raise Overloaded("The models are still being loaded; try again in a second.", retry_after_s=1.0)
        return self._scheduler

    async def close(self, grace_s: float) -> None:
        """Answer what was accepted, for up to `grace_s` seconds, and refuse the rest."""
        self._stopping = True
        if self._scheduler is not None:
            await self._scheduler.close(grace_s)
