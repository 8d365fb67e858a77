"""Settings of the service: one frozen object, built once by the composition root and passed down."""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Literal

from pydantic import Field, SecretStr
from pydantic_settings import BaseSettings, SettingsConfigDict

from service.core.limits import DEFAULT_LIMITS

_PACKAGE = Path(__file__).resolve().parent


def default_models_directory() -> Path:
    """`service/_models` where a wheel put the artefacts, else `models/` of the checkout."""
    installed = _PACKAGE / "_models"
    return installed if installed.is_dir() else _PACKAGE.parent / "models"


def available_cores() -> int:
    """Cores this process may really use: its CPU affinity, cut to the cgroup's quota, at least 1.

    More threads than that make answers slower, not faster: they wait for each other while throttled.
    """
    affinity = getattr(os, "sched_getaffinity", None)
    cores = len(affinity(0)) if affinity else os.cpu_count() or 1
    return max(1, min(cores, math.ceil(_cgroup_cores(Path("/sys/fs/cgroup")))))


def _cgroup_cores(root: Path) -> float:
    """Cores that the cgroup's quota amounts to (v2, else v1); infinity where there is none."""
    try:
        quota, period = (root / "cpu.max").read_text().split()
    except (OSError, ValueError):
        try:
            quota = (root / "cpu" / "cpu.cfs_quota_us").read_text().strip()
            period = (root / "cpu" / "cpu.cfs_period_us").read_text().strip()
        except OSError:
            return 1e9
    if quota in ("max", "-1"):
        return 1e9
    return int(quota) / int(period)


class Settings(BaseSettings):
    """Every field may be set by the environment: `PHYSNET_` and its name in capitals."""

    model_config = SettingsConfigDict(env_prefix="PHYSNET_", frozen=True, extra="ignore")

    host: str = "127.0.0.1"
    """Address to listen on."""

    http_port: int = Field(8000, ge=0, le=65535)
    """Port of the HTTP API; 0 picks a free one, which the ready line names."""

    grpc_port: int = Field(8001, ge=0, le=65535)
    """Port of the gRPC API; 0 picks a free one, which the ready line names."""

    models: Path = Field(default_factory=default_models_directory)
    """Directory of the artefacts, `<name>/<version>/manifest.json`."""

    max_body_bytes: int = Field(32 * 2**20, ge=1024)
    """Largest request body or gRPC message. A 1080p float32 frame is 8 MiB, in base64 11 MiB."""

    max_image_pixels: int = Field(DEFAULT_LIMITS.max_pixels, ge=1)
    """Largest depth image or mask, checked from its header before it is decoded."""

    max_loads: int = Field(64, ge=1)
    """Most pushes in one request."""

    queue_size: int = Field(16, ge=1)
    """Requests that may wait for a worker; further ones are refused at once with a time to try again."""

    reconstruction_bytes: int = Field(64 * 2**20, ge=0)
    """Memory for reconstructions that may be asked again by their id, about 2 MiB each; 0 keeps none."""

    reconstruction_lifetime_s: float = Field(60.0, gt=0.0)
    """How long a reconstruction is kept after its last use, where the memory lasts."""

    workers: int = Field(default_factory=lambda: min(4, available_cores()), ge=1)
    """Requests that are answered at once; by default one for each core this process may use, up to four: beyond that
    they wait for Python's lock more than for cores."""

    threads: int = Field(default_factory=lambda: min(2, available_cores()), ge=1)
    """Threads of each network's session; by default two where there are as many cores, as networks this small gain
    little from more."""

    request_deadline_s: float = Field(10.0, gt=0.0)
    """Longest a request may take from its first byte to inference. Clients may ask for less, never for more."""

    shutdown_grace_s: float = Field(5.0, ge=0.0)
    """How long accepted requests are still answered after SIGTERM."""

    token: SecretStr | None = None
    """Bearer token that `/v1/…` asks for; None leaves the service open, as behind a robot's own network."""

    log_level: Literal["debug", "info", "warning", "error"] = "info"
    """Lowest level written to stderr. Requests that were answered are told of at `debug`."""

    log_format: Literal["text", "json"] = "text"
    """Log lines for people, or one JSON object a line."""

    tracing_endpoint: str | None = None
    """Collector that takes traces as OTLP over gRPC, such as http://127.0.0.1:4317; None traces nothing. Needs the
    extra `tracing`."""

    tracing_share: float = Field(1.0, ge=0.0, le=1.0)
    """Of the requests that no caller's trace came with, the share that is traced."""
