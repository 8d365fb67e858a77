"""Settings from the environment, and the models' files against their manifests."""

from __future__ import annotations

import difflib
import socket
from collections.abc import Iterator, Mapping

from service.commands.checks.check import Check
from service.core.errors import ModelMismatch
from service.settings import Settings

PREFIX = "PHYSNET_"


def check_settings(environment: Mapping[str, str], settings: Settings) -> Iterator[Check]:
    """Variables that mean nothing, and ports that are taken."""
    known = [PREFIX + name.upper() for name in Settings.model_fields]
    given = [name for name in environment if name.upper().startswith(PREFIX)]
    for name in sorted(given):
        if name.upper() not in known and name.upper() != f"{PREFIX}SHARED":
            near = difflib.get_close_matches(name.upper(), known, n=1)
            mend = f"did you mean {near[0]}?" if near else "unset it; docs/operations.md lists the settings"
            yield Check("setting", "warn", f"{name} means nothing to PhysNet", mend)
    yield Check("settings", "ok", ", ".join(sorted(given)) or "all as they come")
    for wire, port in (("HTTP", settings.http_port), ("gRPC", settings.grpc_port)):
        if port and not _is_free(settings.host, port):
            mend = f"if that is not your service: --{wire.lower()}-port 0 picks a free one"
            yield Check("port", "warn", f"{settings.host}:{port} ({wire}) is taken", mend)


def check_models(settings: Settings) -> Iterator[Check]:
    """Every model folder: manifest, contracts, and each file's digest."""
    from service.inference.artefacts import read_manifest

    folders = sorted(path.parent for path in settings.models.glob("*/*/manifest.json"))
    if not folders:
        mend = "install the wheel, which brings models, or name their folder: --models DIR, PHYSNET_MODELS"
        yield Check("models", "fail", f"{settings.models} holds none", mend)
    for folder in folders:
        try:
            manifest = read_manifest(folder)
        except ModelMismatch as error:
            mend = "fetch the files again (git lfs pull, or the wheel), or export the model: physnet-train export"
            yield Check("model", "fail", error.message, mend)
            continue
        size = sum((folder / name).stat().st_size for name in manifest.files)
        told = f"{manifest.name} {manifest.version}, {manifest.kind}, {size / 2**20:.1f} MiB, digests right"
        yield Check("model", "ok", told)


def _is_free(host: str, port: int) -> bool:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((host, port))
        except OSError:
            return False
        return True
