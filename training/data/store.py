"""A data set on disk: one file a group, written whole or not at all, and a manifest over them.

A group is everything drawn from one seed: one body with its loads, or one body with its views. NumPy's own `.npz` is
the format: it needs no further library, a group is read in one call, and a file that is there is complete, since it is
renamed into place. Interrupting a run loses the groups under way and nothing else.
"""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import subprocess
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

STORE_VERSION = 1


class StoreError(Exception):
    """A data set cannot be read or written as asked; the message says what to do."""


@dataclasses.dataclass(frozen=True)
class Store:
    """A folder of groups.

    Attributes:
        root: The folder; `groups/000042.npz` holds group 42, `dropped/000042.json` the reason why there is none.
    """

    root: Path

    def group_path(self, index: int) -> Path:
        return self.root / "groups" / f"{index:06d}.npz"

    def drop_path(self, index: int) -> Path:
        return self.root / "dropped" / f"{index:06d}.json"

    def is_done(self, index: int) -> bool:
        return self.group_path(index).exists() or self.drop_path(index).exists()

    def write_group(self, index: int, arrays: Mapping[str, np.ndarray]) -> None:
        path = self.group_path(index)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        with partial.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **arrays)
        os.replace(partial, path)

    def write_drop(self, index: int, reason: str) -> None:
        path = self.drop_path(index)
        path.parent.mkdir(parents=True, exist_ok=True)
        partial = path.with_suffix(".partial")
        partial.write_text(json.dumps({"reason": reason}))
        os.replace(partial, path)

    def groups(self) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
        """Every group in order of its index."""
        for path in sorted((self.root / "groups").glob("*.npz")):
            with np.load(path, allow_pickle=False) as archive:
                yield int(path.stem), {key: archive[key] for key in archive.files}

    def write_manifest(self, configuration: Mapping[str, Any]) -> dict[str, Any]:
        """Close the set: configuration, code version, counts and the digest over all arrays in order."""
        digest = hashlib.sha256()
        samples = 0
        for index, arrays in self.groups():
            digest.update(str(index).encode())
            for key in sorted(arrays):
                digest.update(key.encode() + arrays[key].tobytes())
            samples += len(arrays["sample"])
        drops = Counter(json.loads(p.read_text())["reason"] for p in (self.root / "dropped").glob("*.json"))
        manifest = {
            "store_version": STORE_VERSION,
            "configuration": dict(configuration),
            "code": code_version(),
            "groups": sum(1 for _ in (self.root / "groups").glob("*.npz")),
            "samples": samples,
            "dropped": dict(sorted(drops.items())),
            "digest": "sha256:" + digest.hexdigest(),
        }
        (self.root / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n")
        return manifest

    def manifest(self) -> dict[str, Any]:
        """Raises: StoreError: There is none, or it is of another store version."""
        path = self.root / "manifest.json"
        if not path.exists():
            raise StoreError(f"{self.root} has no manifest.json; finish it with `physnet-train simulate`")
        manifest: dict[str, Any] = json.loads(path.read_text())
        if manifest["store_version"] != STORE_VERSION:
            raise StoreError(
                f"{self.root} is a store of version {manifest['store_version']}, this code reads {STORE_VERSION}; "
                "generate it again from its manifest"
            )
        return manifest


def code_version() -> str:
    """Git commit of the code, with `+dirty` where files differ from it; `unknown` outside a repository."""
    here = Path(__file__).parent
    try:
        commit = subprocess.run(
            ["git", "rev-parse", "HEAD"], cwd=here, capture_output=True, text=True, check=True
        ).stdout.strip()
        changed = subprocess.run(
            ["git", "status", "--porcelain", "--", "training", "service"],
            cwd=here.parent.parent, capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return commit + ("+dirty" if changed.strip() else "")
