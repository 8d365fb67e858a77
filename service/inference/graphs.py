"""The networks of a folder: found by their manifests, checked, opened."""

from __future__ import annotations

from pathlib import Path

from service.core.errors import ModelMismatch
from service.core.manifest import Manifest
from service.inference.artefacts import read_manifest
from service.inference.graph import Graph
from service.inference.session import open_sessions

KINDS = {"reconstruction": (True,), "deformation": (False, True)}
"""And the graphs in which this service runs them: whether it waits for one, or runs it beside other work, where a
second thread would only be in the way."""


def open_graphs(directory: Path, threads: int) -> tuple[Graph, ...]:
    """Open the newest version of the model of each of `KINDS` under a folder laid out as `<name>/<version>/`.

    Raises:
        ModelMismatch: A kind is missing or twice there, or a model does not fit its manifest or this service.
    """
    newest: dict[str, tuple[tuple[int, ...], Path]] = {}
    for path in sorted(directory.glob("*/*/manifest.json")):
        name, version = path.parent.parent.name, _version_key(path.parent)
        if name not in newest or version > newest[name][0]:
            newest[name] = (version, path.parent)
    by_kind: dict[str, tuple[Path, Manifest]] = {}
    for _, folder in newest.values():
        manifest = read_manifest(folder)
        if (manifest.name, manifest.version) != (folder.parent.name, folder.name):
            raise ModelMismatch(
                f"{folder} holds {manifest.name} {manifest.version}; a model lies in <name>/<version>/.",
                expected=f"{folder.parent.name} {folder.name}", actual=f"{manifest.name} {manifest.version}",
            )  # fmt: skip
        if manifest.kind in by_kind:
            raise ModelMismatch(f"{directory} holds two {manifest.kind} models; leave one or name another folder.")
        if len(manifest.graphs) != (count := len(KINDS[manifest.kind])):
            raise ModelMismatch(
                f"{folder} is not in {count} graphs, as this service runs it; export it again.",
                expected=count, actual=len(manifest.graphs),
            )  # fmt: skip
        by_kind[manifest.kind] = (folder, manifest)
    for kind in KINDS:
        if kind not in by_kind:
            raise ModelMismatch(f"{directory} holds no {kind} model; export one with `physnet-train export`.")
    return tuple(
        Graph(open_sessions(*by_kind[kind], [threads if waits else 1 for waits in graphs]), by_kind[kind][1])
        for kind, graphs in KINDS.items()
    )


def _version_key(folder: Path) -> tuple[int, ...]:
    try:
        return tuple(int(part) for part in folder.name.split("."))
    except ValueError as error:
        raise ModelMismatch(f"{folder}: a version is numbers and dots, such as 0.1.0.") from error
