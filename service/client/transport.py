"""The two wires behind one face: what a client asks of either, and how their addresses are told apart."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable
from urllib.parse import urlsplit

from service.client.question import Question
from service.client.result import Result

HTTP_SCHEMES = ("http", "https")
GRPC_SCHEMES = ("grpc", "grpcs")


@dataclass(frozen=True)
class NamedMaterial:
    """A material that the service knows by name.

    Attributes:
        name: What a question may call it.
        young_modulus_pa, poisson_ratio: Typical values.
        young_modulus_range_pa: Within which sources put Young's modulus.
        description: What it is.
        source: Where the values come from.
    """

    name: str
    young_modulus_pa: float
    poisson_ratio: float
    young_modulus_range_pa: tuple[float, float]
    description: str
    source: str


@dataclass(frozen=True)
class Skipped:
    """A frame that was overtaken before inference."""

    overtaken_by: int


@runtime_checkable
class Transport(Protocol):
    """One wire, blocking. Each method raises `PhysNetError` and tries once."""

    def deform(self, question: Question, timeout_s: float) -> Result: ...
    def materials(self, query: str, timeout_s: float) -> list[NamedMaterial]: ...
    def models(self, timeout_s: float) -> list[dict[str, Any]]: ...
    def close(self) -> None: ...


@runtime_checkable
class AsyncTransport(Protocol):
    """The same for asyncio."""

    async def deform(self, question: Question, timeout_s: float) -> Result: ...
    async def materials(self, query: str, timeout_s: float) -> list[NamedMaterial]: ...
    async def models(self, timeout_s: float) -> list[dict[str, Any]]: ...
    async def close(self) -> None: ...


@dataclass(frozen=True)
class Address:
    """Where a service is, and over which wire.

    Attributes:
        grpc: Whether the wire is gRPC.
        secure: Whether TLS is spoken.
        target: gRPC's target, or the base URL of HTTP.
    """

    grpc: bool
    secure: bool
    target: str


def address(url: str) -> Address:
    """Of `http://HOST:PORT`, `https://…`, `grpc://HOST:PORT` or `grpcs://…`.

    Raises:
        ValueError: Another scheme, or no host.
    """
    parts = urlsplit(url)
    if parts.scheme not in HTTP_SCHEMES + GRPC_SCHEMES or not parts.hostname:
        raise ValueError(f"{url!r} is no address of a service: http://HOST:PORT or grpc://HOST:PORT")
    grpc = parts.scheme in GRPC_SCHEMES
    if grpc and not parts.port:
        raise ValueError(f"{url!r} names no port: gRPC's is in the ready line of the service")
    return Address(grpc, parts.scheme in ("https", "grpcs"), parts.netloc if grpc else url.rstrip("/"))


def named_materials(documents: Sequence[Mapping[str, Any]]) -> list[NamedMaterial]:
    """Materials from the documents of `GET /v1/materials`."""
    return list(_named(documents))


def _named(documents: Sequence[Mapping[str, Any]]) -> Iterator[NamedMaterial]:
    for entry in documents:
        low_pa, high_pa = entry["young_modulus_range_pa"]
        numbers = {name: entry[name] for name in ("young_modulus_pa", "poisson_ratio", "description", "source")}
        yield NamedMaterial(entry["name"], young_modulus_range_pa=(low_pa, high_pa), **numbers)
