"""Composition root: builds everything from the settings, serves it, and takes it down in order."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes
import gc
import logging
import signal
import socket
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import uvicorn

from service.api.handler import Handler
from service.api.logs import configure
from service.api.oip_models import Models
from service.api.openapi import API_VERSION
from service.api.rest import create_http
from service.api.rpc_server import GrpcServer
from service.api.tracing import make_tracer
from service.core.errors import PhysNetError
from service.core.manifest import Manifest
from service.inference.graph import Graph
from service.reconstructions import Reconstructions
from service.scheduler import Predictor, Scheduler
from service.settings import Settings, available_cores

log = logging.getLogger(__name__)

KEEP_ALIVE_S = 75
"""A robot that asks once a minute keeps its connection."""

SWITCH_INTERVAL_S = 0.0003
"""After which a thread lets others at Python: workers and the event loop wait for each other less than with the usual
5 ms, which saves 1 to 2 ms of a frame at the median."""

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Names of two of glibc's parameters. Source: malloc.h."""


@dataclass(frozen=True)
class Served:
    """What answers requests, warmed up, its models' manifests, the networks as they are, and what it keeps."""

    predictor: Predictor
    manifests: Sequence[Manifest]
    graphs: Sequence[Graph] = ()
    kept: Reconstructions[Any] | None = None


def build_pipeline(settings: Settings) -> Served:
    """Load and warm up the models and put the pipeline on them.

    Raises:
        ModelMismatch: An artefact is missing or does not fit its manifest or this service.
    """
    # Imported here, beside the event loop: this takes longer than all the rest of the start, and `/healthz` answers
    # meanwhile. ONNX Runtime opens its graphs on another core while Numba is imported.
    from service.inference.graphs import open_graphs

    with ThreadPoolExecutor(1) as beside:
        opened = beside.submit(open_graphs, settings.models, settings.threads)
        from service.core.limits import FrameLimits
        from service.inference.registry import models_of
        from service.pipeline import Body, Pipeline
        from service.warm_up import warm_up

        models = models_of(opened.result(), available_cores())
    warm_up(models)
    limits = FrameLimits(max_pixels=settings.max_image_pixels, max_bytes=settings.max_body_bytes)
    kept = Reconstructions[Body](settings.reconstruction_bytes, settings.reconstruction_lifetime_s)
    pipeline = Pipeline(models.reconstruction, models.deformation, limits, kept)
    return Served(pipeline, models.manifests, models.graphs, kept)


class _Server(uvicorn.Server):
    """Leaves signals to us: uvicorn raises them again on its way out, and a stopped service is no failure."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        yield


async def serve(
    settings: Settings,
    build: Callable[[Settings], Served] = build_pipeline,
    stop: asyncio.Event | None = None,
    announce: Callable[[str], None] = print,
) -> int:
    """Serve until SIGTERM or SIGINT (or `stop`).

    Args:
        settings: All there is to choose.
        build: What makes the predictor; runs beside the event loop, so that `/healthz` answers meanwhile.
        stop: Ends the service when set, in place of a signal.
        announce: Called once with the ready line when requests are answered.

    Returns:
        Exit code: 0 after a stop that was asked for, 1 where the models could not be loaded.

    Raises:
        OSError: A port is taken.
    """
    stop = stop or asyncio.Event()
    _stop_on_signals(stop)
    try:
        tracer = make_tracer(settings.tracing_endpoint, settings.tracing_share, API_VERSION)
    except ImportError as error:
        log.error("%s", error)
        return 1
    handler = Handler(tracer)
    models = Models(handler, settings.max_loads)
    rpc = GrpcServer(handler, settings, models)
    listener = _listen(settings.host, settings.http_port)
    try:
        grpc_port = await rpc.start()
    except OSError:
        listener.close()
        raise
    server = _Server(
        uvicorn.Config(
            create_http(handler, settings, models),
            log_config=None,
            access_log=False,
            lifespan="off",
            server_header=False,
            timeout_keep_alive=KEEP_ALIVE_S,
            ws="websockets-sansio",
            ws_max_size=settings.max_body_bytes,
            # Packing an answer takes longer than sending it over any network a slider can be followed on.
            ws_per_message_deflate=False,
            timeout_graceful_shutdown=max(1, round(settings.shutdown_grace_s)),
        )
    )
    serving = asyncio.create_task(server.serve(sockets=[listener]))
    stopped = asyncio.create_task(stop.wait())
    loading = asyncio.create_task(asyncio.to_thread(build, settings))
    try:
        await asyncio.wait({loading, stopped, serving}, return_when=asyncio.FIRST_COMPLETED)
        if loading.done():
            served = loading.result()
            scheduler = Scheduler(served.predictor, settings.queue_size, settings.workers)
            handler.open(scheduler, served.manifests, served.graphs, served.kept)
            await rpc.ready()
            host, http_port = listener.getsockname()[:2]
            host = f"[{host}]" if ":" in host else host
            announce(f"ready http={host}:{http_port} grpc={host}:{grpc_port}")
            models_served = {manifest.kind: f"{manifest.name} {manifest.version}" for manifest in served.manifests}
            log.info("ready: %s", models_served, extra={"models": models_served})
            await asyncio.wait({stopped, serving}, return_when=asyncio.FIRST_COMPLETED)
        return 0
    except Exception as error:
        # What a ModelMismatch says is for the operator; anything else is a bug and needs its traceback.
        log.error("the models could not be loaded: %s", error, exc_info=not isinstance(error, PhysNetError))
        return 1
    finally:
        log.info("stopping")
        # First the queue, so that its replies still find their connections; then the connections.
        await rpc.stopping()
        await handler.close(settings.shutdown_grace_s)
        await rpc.stop()
        server.should_exit = True
        await serving
        stopped.cancel()
        # Sending what is left takes as long as the collector lets it, up to the grace that requests had.
        with contextlib.suppress(TimeoutError):
            await asyncio.wait_for(asyncio.to_thread(handler.tracer.close), max(1.0, settings.shutdown_grace_s))


def _stop_on_signals(stop: asyncio.Event) -> None:
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        # Only the main thread may take signals; tests serve from another one and set `stop` themselves.
        with contextlib.suppress(ValueError, RuntimeError, NotImplementedError):
            loop.add_signal_handler(number, stop.set)


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    return socket.create_server((host, port), family=family, backlog=256)


def run(settings: Settings) -> int:
    """`serve` on the fastest event loop there is, logging to stderr."""
    keep_freed_memory()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    gc.disable()  # until it is ready: nearly all that is made before stays
    configure(settings.log_level, settings.log_format)
    with asyncio.Runner(loop_factory=_loop_factory()) as runner:
        return runner.run(serve(settings, announce=_announce))


def keep_freed_memory() -> None:
    """Keep memory that an answer has freed for the next one, up to 32 MiB a thread.

    Otherwise the C library hands arrays of a megabyte back to the system and is given new ones page by page: half of
    the time that a reply with a displacement field takes to encode. Resident memory is larger by 20 MiB for it.
    """
    with contextlib.suppress(OSError, AttributeError):  # where the C library is another
        libc = ctypes.CDLL(None)
        libc.mallopt(M_MMAP_THRESHOLD, 2**24)
        libc.mallopt(M_TRIM_THRESHOLD, 2**25)


def _announce(line: str) -> None:
    # What is loaded stays: it need not be looked through whenever garbage is collected.
    gc.freeze()
    gc.enable()
    # Whoever started us waits for this line on a pipe, which Python would otherwise hold back.
    print(line, flush=True)


def _loop_factory() -> Callable[[], asyncio.AbstractEventLoop]:
    try:
        import uvloop
    except ImportError:
        return asyncio.new_event_loop
    return uvloop.new_event_loop
