"""One sample of a set at a time, in any order, without reading the group around it."""

from __future__ import annotations

import io
import struct
import zipfile
import zlib
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from training.data.store import Store, StoreError, damaged

_LOCAL_HEADER = struct.Struct("<4s5H3L2H")
"""What stands before the bytes of an entry; its last two numbers are the lengths of the name and of extra fields."""
HEADS = 4096
"""Groups whose directory and small columns are kept: about 40 kB each."""


class RandomAccess:
    """Samples of a store by group and row.

    A group's directory and its small columns are read when it is first asked for. After that a sample costs its own
    voxels and fields: one seek, one read and one inflation for each. Groups that were written before rows stood apart
    are read whole, once each for as long as few are in use.

    Args:
        store: A set, finished or not.
    """

    def __init__(self, store: Store) -> None:
        store.check_version()
        self._store = store
        self._head = lru_cache(HEADS)(self._read_head)
        self._whole = lru_cache(8)(store.group)

    def rows(self, group: int) -> int:
        """How many samples a group has.

        Raises:
            StoreError: There is no such group, or it is damaged.
        """
        return len(self._head(group).columns["sample"])

    def sample(self, group: int, row: int) -> dict[str, np.ndarray]:
        """Every column of a sample, and what it shares with the others of its group (`rest`, `nodes`, …).

        Raises:
            IndexError: The group has no such row.
            StoreError: There is no such group, or it is damaged.
        """
        head = self._head(group)
        count = len(head.columns["sample"])
        if not 0 <= row < count:
            raise IndexError(f"group {group} has {count} samples, no row {row}")
        columns = head.columns if head.apart else self._whole(group)
        own = {key: value[row] if value.ndim and len(value) == count else value for key, value in columns.items()}
        for name, rows in head.apart.items():
            own[name] = head.read(rows[row])
        return own

    def _read_head(self, group: int) -> _Head:
        path = self._store.group_path(group)
        try:
            with zipfile.ZipFile(path) as archive:
                entries = {info.filename.removesuffix(".npy"): info for info in archive.infolist()}
        except FileNotFoundError as error:
            raise StoreError(f"{self._store.root} has no group {group}") from error
        except zipfile.BadZipFile as error:
            raise damaged(path, error) from error
        apart: dict[str, list[zipfile.ZipInfo]] = {}
        for name in sorted(name for name in entries if "/" in name):
            apart.setdefault(name.split("/")[0], []).append(entries[name])
        return _Head(path, {name: info for name, info in entries.items() if "/" not in name}, apart)


@dataclass(frozen=True)
class _Head:
    """Where the arrays of a group lie in its file."""

    path: Path
    together: dict[str, zipfile.ZipInfo]
    apart: dict[str, list[zipfile.ZipInfo]]

    @cached_property
    def columns(self) -> dict[str, np.ndarray]:
        """The arrays that are kept for all rows together; where no row stands apart, only the numbering."""
        names = self.together if self.apart else ("sample",)
        return {name: self.read(self.together[name]) for name in names}

    def read(self, info: zipfile.ZipInfo) -> np.ndarray:
        """The array of an entry."""
        try:
            with self.path.open("rb") as file:
                file.seek(info.header_offset)
                *_, name, extra = _LOCAL_HEADER.unpack(file.read(_LOCAL_HEADER.size))
                file.seek(name + extra, io.SEEK_CUR)
                content = zlib.decompress(file.read(info.compress_size), wbits=-zlib.MAX_WBITS, bufsize=info.file_size)
            if zlib.crc32(content) != info.CRC:
                raise ValueError("checksum differs")
            return np.asarray(np.lib.format.read_array(io.BytesIO(content), allow_pickle=False))
        except (zlib.error, ValueError, struct.error) as error:
            raise damaged(self.path, error) from error
