"""The gRPC server: its services, health, reflection and limits."""

from __future__ import annotations

from typing import Any

import grpc
from google.protobuf.descriptor_pool import DescriptorPool
from grpc_health.v1 import health, health_pb2, health_pb2_grpc
from grpc_reflection.v1alpha import reflection, reflection_pb2

from service.api import oip_messages
from service.api.generated import deformation_pb2
from service.api.handler import Handler
from service.api.oip_models import Models
from service.api.oip_rpc import InferenceService
from service.api.openapi import API_VERSION
from service.api.rpc import SERVICE, DeformationService
from service.api.rpc_call import Calls
from service.api.rpc_handlers import generic_handler
from service.settings import Settings

LOAD_BYTES = 64**3 * (3 * 2 + 1) + 64**3 // 8
"""Of one load in a reply: displacement, probability and occupancy."""

SCENE_BYTES = 4 * 2**20
"""Of one surface in a scene; a smooth body's is a fifth of it, and a reply with many crumpled ones fails alone."""

FLUSH_S = 0.5
"""What was answered before a stop still has this long to reach its client; open streams end then."""


class GrpcServer:
    """The server, before and after the models are loaded. To be made inside the event loop it serves on."""

    def __init__(self, handler: Handler, settings: Settings, models: Models) -> None:
        self._server = grpc.aio.server(options=_options(settings))
        self._health = health.aio.HealthServicer()
        self._services = [SERVICE, oip_messages.SERVICE]
        calls = Calls(handler, settings)
        ours = deformation_pb2.DESCRIPTOR.services_by_name["DeformationService"]
        standard = InferenceService(models, settings, calls, API_VERSION)
        self._server.add_generic_rpc_handlers(
            (
                generic_handler(ours, DeformationService(handler, settings, calls), calls),
                generic_handler(oip_messages.DESCRIPTION, standard, calls),
            )
        )
        health_pb2_grpc.add_HealthServicer_to_server(self._health, self._server)
        described = [*self._services, health.SERVICE_NAME, reflection.SERVICE_NAME]
        reflection.enable_server_reflection(described, self._server, pool=_descriptors())
        self._host = settings.host
        self._port = settings.grpc_port

    async def start(self) -> int:
        """Listen; returns the port. Health says NOT_SERVING until `ready`.

        Raises:
            OSError: The port is taken.
        """
        await self._say(serving=False)
        host = f"[{self._host}]" if ":" in self._host else self._host
        try:
            port = self._server.add_insecure_port(f"{host}:{self._port}")
        except RuntimeError as error:
            raise OSError(f"gRPC cannot listen on {host}:{self._port}: {error}") from None
        await self._server.start()
        return int(port)

    async def ready(self) -> None:
        """The models are loaded and warmed up."""
        await self._say(serving=True)

    async def stopping(self) -> None:
        """Health says NOT_SERVING from here on, whatever happens."""
        await self._health.enter_graceful_shutdown()

    async def stop(self) -> None:
        """Take no more calls, and end those that are still open shortly after."""
        await self._server.stop(FLUSH_S)

    async def _say(self, *, serving: bool) -> None:
        answers = health_pb2.HealthCheckResponse
        status = answers.SERVING if serving else answers.NOT_SERVING
        for service in ("", *self._services):
            await self._health.set(service, status)


def _options(settings: Settings) -> list[tuple[str, int]]:
    return [
        # A second service on the same port is a mistake, not a way to share the load.
        ("grpc.so_reuseport", 0),
        ("grpc.max_receive_message_length", settings.max_body_bytes),
        # As long as the largest reply there is: grids of the frame and everything of each load.
        ("grpc.max_send_message_length", 2**20 + SCENE_BYTES + settings.max_loads * (LOAD_BYTES + SCENE_BYTES + 2**10)),
        ("grpc.max_concurrent_streams", 128),
        # A robot that was switched off, or lost its network, gives its streams up within 15 s.
        ("grpc.keepalive_time_ms", 10_000),
        ("grpc.keepalive_timeout_ms", 5_000),
        ("grpc.keepalive_permit_without_calls", 1),
        # Robots behind radio links ping as often as they like: never GOAWAY with too_many_pings.
        ("grpc.http2.max_pings_without_data", 0),
        ("grpc.http2.min_recv_ping_interval_without_data_ms", 1_000),
        ("grpc.http2.max_ping_strikes", 0),
    ]


def _descriptors() -> Any:
    """What reflection tells of: a pool of its own, which holds every file that a service here is described in."""
    files = {oip_messages.FILE_NAME: oip_messages.FILE_BYTES}
    for module in (deformation_pb2, health_pb2, reflection_pb2):
        _collect(module.DESCRIPTOR, files)
    pool = DescriptorPool()
    for content in files.values():
        pool.AddSerializedFile(content)
    return pool


# Descriptors are of whichever implementation of protobuf is installed, which has no common class.
def _collect(file: Any, files: dict[str, bytes]) -> None:
    """Add a file, after those that it imports."""
    for imported in file.dependencies:
        _collect(imported, files)
    files.setdefault(file.name, file.serialized_pb)
