"""A data set on disk: one file a group, written whole or not at all, and a manifest over them.

A group is everything drawn from one seed: one body with its loads, or one body with its views. NumPy's own `.npz` is
the format: it needs no further library, a group is read in one call, and a file that is there is complete, since it is
renamed into place. Interrupting a run, or a full disk, loses the groups under way and nothing else.
"""

from __future__ import annotations

import contextlib
import dataclasses
import errno
import hashlib
import json
import os
import subprocess
import zipfile
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

STORE_VERSION = 3
"""2: fields are kept at the nodes near the body, forward as well as backward; coverage follows from the bits.
3: von Mises stress and how each state converged. A set stays in the version that it began in: one of version 2 is read,
and added to, without them."""

_ADDED = {"von_mises": 3, "peak_von_mises": 3, "convergence": 3}
"""Columns that sets before these versions do not have."""
_OLDEST = 2
"""First version that is read."""

COMPRESSION = 1
"""Level of the deflate: level 6, NumPy's own, takes half as long again for 3 % less (measured on one group)."""

ROW_BYTES = 4096
"""From this size on the row of a sample is compressed by itself, so that it can be read without the others."""

_FULL = (errno.ENOSPC, errno.EDQUOT)


class StoreError(Exception):
    """A data set cannot be read or written as asked; the message says what to do."""


@dataclasses.dataclass(frozen=True)
class Store:
    """A folder of groups.

    Attributes:
        root: The folder; `groups/000042.npz` holds group 42, `dropped/000042.json` the reason why there is none, and
            `store.json` the version and what is drawn.
    """

    root: Path

    def group_path(self, index: int) -> Path:
        return self.root / "groups" / f"{index:06d}.npz"

    def drop_path(self, index: int) -> Path:
        return self.root / "dropped" / f"{index:06d}.json"

    @property
    def manifest_path(self) -> Path:
        return self.root / "manifest.json"

    @property
    def header_path(self) -> Path:
        return self.root / "store.json"

    def is_done(self, index: int) -> bool:
        return self.group_path(index).exists() or self.drop_path(index).exists()

    def begin(self, configuration: Mapping[str, Any]) -> None:
        """Open the folder for drawing; how many groups are wanted may change from one time to the next.

        Raises:
            StoreError: It holds a set of another configuration or store version, or the disk is full.
        """
        self.check_version()
        wanted = json.loads(json.dumps({key: value for key, value in configuration.items() if key != "groups"}))
        found = self._header().get("configuration")
        # what sets of older code do not have yet is None in those of newer code
        changed = sorted(key for key in {*(found or {}), *wanted} if found and found.get(key) != wanted.get(key))
        if changed:
            raise StoreError(
                f"{self.root} holds a data set drawn otherwise ({', '.join(changed)} differ); take another folder"
            )
        if found is None:
            header = {"store_version": STORE_VERSION, "configuration": wanted}
            self._write(self.header_path, json.dumps(header, indent=1).encode())

    def write_group(self, index: int, arrays: Mapping[str, np.ndarray]) -> None:
        """Raises: StoreError: The disk is full; what was written before is whole."""
        version = self._begun()
        path = self.group_path(index)
        kept = {name: array for name, array in arrays.items() if _ADDED.get(name, version) <= version}
        with self._whole(path) as partial, zipfile.ZipFile(partial, "w") as archive:
            for name, array in _entries(kept):
                # a fixed date: the same arrays give the same file
                entry = zipfile.ZipInfo(f"{name}.npy")
                entry.compress_type, entry._compresslevel = zipfile.ZIP_DEFLATED, COMPRESSION  # type: ignore[attr-defined]
                with archive.open(entry, "w", force_zip64=True) as file:
                    np.lib.format.write_array(file, array, allow_pickle=False)

    def write_drop(self, index: int, reason: str) -> None:
        """Raises: StoreError: The disk is full."""
        self._begun()
        self._write(self.drop_path(index), json.dumps({"reason": reason}).encode())

    def groups(self) -> Iterator[tuple[int, dict[str, np.ndarray]]]:
        """Every group in order of its index.

        Raises:
            StoreError: The store is of another version, or a group is damaged.
        """
        self.check_version()
        for path in sorted((self.root / "groups").glob("*.npz")):
            yield int(path.stem), self._read(path)

    def group(self, index: int) -> dict[str, np.ndarray]:
        """One group.

        Raises:
            StoreError: It is not there or damaged, or the store is of another version.
        """
        self.check_version()
        return self._read(self.group_path(index))

    def check_version(self) -> None:
        """Raises: StoreError: There are groups of another store version."""
        header = self._header()
        if not header and next((self.root / "groups").glob("*.npz"), None) is not None:
            header = {"store_version": 1}  # the first version said its number in the manifest only
        version = header.get("store_version", STORE_VERSION)
        if not _OLDEST <= version <= STORE_VERSION:
            raise StoreError(
                f"{self.root} is a store of version {version}, this code reads {_OLDEST} to {STORE_VERSION}; "
                "generate it again from its manifest"
            )

    def write_manifest(self, configuration: Mapping[str, Any]) -> dict[str, Any]:
        """Close the set: configuration, code version, counts and the digest over all arrays in order."""
        digest, groups, samples = self.digest()
        drops = Counter(json.loads(p.read_text())["reason"] for p in (self.root / "dropped").glob("*.json"))
        manifest = {
            "store_version": self._begun(),
            "configuration": dict(configuration),
            "code": code_version(),
            "groups": groups,
            "samples": samples,
            "dropped": dict(sorted(drops.items())),
            "digest": digest,
        }
        self._write(self.manifest_path, json.dumps(manifest, indent=1).encode() + b"\n")
        return manifest

    def digest(self) -> tuple[str, int, int]:
        """SHA-256 over all arrays in order, and how many groups and samples there are."""
        digest = hashlib.sha256()
        groups = samples = 0
        for index, arrays in self.groups():
            digest.update(str(index).encode())
            for key in sorted(arrays):
                digest.update(key.encode() + arrays[key].tobytes())
            groups, samples = groups + 1, samples + len(arrays["sample"])
        return "sha256:" + digest.hexdigest(), groups, samples

    def manifest(self) -> dict[str, Any]:
        """Raises: StoreError: There is none, or it is of another store version."""
        self.check_version()
        if not self.manifest_path.exists():
            raise StoreError(f"{self.root} has no manifest.json; finish it with `physnet-train simulate`")
        manifest: dict[str, Any] = json.loads(self.manifest_path.read_text())
        return manifest

    def about(self) -> str:
        """The finished set in a line: its name and seed, how much there is, digest and code.

        Raises:
            StoreError: It has no manifest, or is of another store version.
        """
        manifest = self.manifest()
        drawn = manifest["configuration"]
        return (
            f"{drawn.get('set')}, seed {drawn.get('seed')}: {manifest['samples']} samples in {manifest['groups']} "
            f"groups, {manifest['digest']}, made at {manifest['code']}"
        )

    def _header(self) -> dict[str, Any]:
        try:
            header: dict[str, Any] = json.loads(self.header_path.read_text())
        except FileNotFoundError:
            return {}
        return header

    def _begun(self) -> int:
        """The version of the set, which begins here if it has none."""
        if not self.header_path.exists():
            self._write(self.header_path, json.dumps({"store_version": STORE_VERSION}).encode())
        return int(self._header().get("store_version", STORE_VERSION))

    def _read(self, path: Path) -> dict[str, np.ndarray]:
        try:
            # opened here: np.load leaves a file open that turns out to be no archive
            with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
                return _joined({key: archive[key] for key in archive.files})
        except FileNotFoundError as error:
            raise StoreError(f"{self.root} has no group {int(path.stem)}") from error
        except (zipfile.BadZipFile, zlib.error, ValueError, EOFError) as error:
            raise damaged(path, error) from error

    def _write(self, path: Path, content: bytes) -> None:
        with self._whole(path) as partial:
            partial.write_bytes(content)

    @contextlib.contextmanager
    def _whole(self, path: Path) -> Iterator[Path]:
        """A file beside the wanted one, renamed into place when it is complete and removed when it is not."""
        # of this process alone: two that draw the same group do not write into each other's file
        partial = path.with_suffix(f".{os.getpid()}.partial")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            yield partial
            os.replace(partial, path)
        except BaseException as error:
            with contextlib.suppress(OSError):
                partial.unlink(missing_ok=True)
            if isinstance(error, OSError) and error.errno in _FULL:
                raise StoreError(
                    f"no space left on the disk of {self.root}; what is written is whole: make room and give the same "
                    "command again"
                ) from error
            raise


def damaged(path: Path, error: Exception) -> StoreError:
    """The error of a group that cannot be read."""
    return StoreError(f"{path} is damaged ({error}); delete it and run the same `simulate` again")


def _entries(arrays: Mapping[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    """Arrays as they are written: large ones with a row for each sample row by row, as `name/0003`."""
    samples = len(arrays["sample"]) if "sample" in arrays else 0
    for name, given in arrays.items():
        array = np.asanyarray(given)
        if samples and array.ndim > 1 and len(array) == samples and array.nbytes >= ROW_BYTES * samples:
            for row, values in enumerate(array):
                yield f"{name}/{row:04d}", values
        else:
            yield name, array


def _joined(entries: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The arrays that were written by `_entries`; those of older groups have no rows apart."""
    rows: dict[str, list[np.ndarray]] = {}
    for name in sorted(entries):
        rows.setdefault(name.split("/")[0], []).append(entries[name])
    return {name: np.stack(parts) if f"{name}/0000" in entries else parts[0] for name, parts in rows.items()}


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
