"""gRPC: typed messages over one connection that is kept alive."""

from __future__ import annotations

import json
from collections.abc import AsyncIterator, Iterator
from typing import Any

import grpc

from service.api.generated import deformation_pb2 as pb
from service.api.generated.deformation_pb2_grpc import DeformationServiceStub
from service.client import grpc_wire
from service.client.errors import ServiceUnreachable
from service.client.question import Question
from service.client.result import Result
from service.client.transport import NamedMaterial

Metadata = tuple[tuple[str, str], ...]


class GrpcTransport:
    """Blocking; may be used from many threads."""

    def __init__(self, target: str, *, secure: bool, token: str | None) -> None:
        self.metadata = _metadata(token)
        if secure:
            self._channel = grpc.secure_channel(target, grpc.ssl_channel_credentials(), grpc_wire.OPTIONS)
        else:
            self._channel = grpc.insecure_channel(target, grpc_wire.OPTIONS)
        self.stub: Any = DeformationServiceStub(self._channel)

    def deform(self, question: Question, timeout_s: float) -> Result:
        """DeformationService.Deform."""
        return grpc_wire.result(self._ask(self.stub.Deform, grpc_wire.encode(question), timeout_s))

    def materials(self, query: str, timeout_s: float) -> list[NamedMaterial]:
        """DeformationService.ListMaterials."""
        return _materials(self._ask(self.stub.ListMaterials, pb.ListMaterialsRequest(query=query), timeout_s))

    def models(self, timeout_s: float) -> list[dict[str, Any]]:
        """DeformationService.GetModel."""
        return _models(self._ask(self.stub.GetModel, pb.GetModelRequest(), timeout_s))

    def stream(self, frames: Iterator[pb.DeformStreamRequest]) -> Any:
        """DeformationService.DeformStream: a call that can be iterated over and cancelled.

        Raises:
            ServiceUnreachable: The client is closed.
        """
        try:
            return self.stub.DeformStream(frames, metadata=self.metadata)
        except ValueError as error:  # grpc's word for it
            raise ServiceUnreachable("The client is closed.") from error

    def close(self) -> None:
        """Close the connection."""
        self._channel.close()

    def _ask(self, method: Any, message: Any, timeout_s: float) -> Any:
        try:
            return method(message, timeout=timeout_s, metadata=self.metadata)
        except grpc.RpcError as error:
            raise grpc_wire.error_of(error, timeout_s) from error
        except ValueError as error:  # grpc's word for it
            raise ServiceUnreachable("The client is closed.") from error


class AsyncGrpcTransport:
    """For asyncio, on the event loop it is made on."""

    def __init__(self, target: str, *, secure: bool, token: str | None) -> None:
        self.metadata = _metadata(token)
        if secure:
            credentials = grpc.ssl_channel_credentials()
            self._channel = grpc.aio.secure_channel(target, credentials, grpc_wire.OPTIONS)
        else:
            self._channel = grpc.aio.insecure_channel(target, grpc_wire.OPTIONS)
        self.stub: Any = DeformationServiceStub(self._channel)

    async def deform(self, question: Question, timeout_s: float) -> Result:
        """DeformationService.Deform."""
        return grpc_wire.result(await self._ask(self.stub.Deform, grpc_wire.encode(question), timeout_s))

    async def materials(self, query: str, timeout_s: float) -> list[NamedMaterial]:
        """DeformationService.ListMaterials."""
        return _materials(await self._ask(self.stub.ListMaterials, pb.ListMaterialsRequest(query=query), timeout_s))

    async def models(self, timeout_s: float) -> list[dict[str, Any]]:
        """DeformationService.GetModel."""
        return _models(await self._ask(self.stub.GetModel, pb.GetModelRequest(), timeout_s))

    def stream(self, frames: AsyncIterator[pb.DeformStreamRequest]) -> Any:
        """DeformationService.DeformStream: a call that can be iterated over and cancelled."""
        return self.stub.DeformStream(frames, metadata=self.metadata)

    async def close(self) -> None:
        """Close the connection."""
        await self._channel.close()

    async def _ask(self, method: Any, message: Any, timeout_s: float) -> Any:
        try:
            return await method(message, timeout=timeout_s, metadata=self.metadata)
        except grpc.RpcError as error:
            raise grpc_wire.error_of(error, timeout_s) from error


def _metadata(token: str | None) -> Metadata:
    return (("authorization", f"Bearer {token}"),) if token else ()


def _materials(response: pb.ListMaterialsResponse) -> list[NamedMaterial]:
    return [
        NamedMaterial(
            name=entry.name,
            young_modulus_pa=entry.young_modulus_pa,
            poisson_ratio=entry.poisson_ratio,
            young_modulus_range_pa=(entry.young_modulus_min_pa, entry.young_modulus_max_pa),
            description=entry.description,
            source=entry.source,
        )
        for entry in response.materials
    ]


def _models(response: pb.GetModelResponse) -> list[dict[str, Any]]:
    return [json.loads(model.manifest_json) for model in response.models]
