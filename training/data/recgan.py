"""Pairs of a partial view and the full shape, as 3D-RecGAN's authors release them, read into a store of views.

A grid is a text file of occupied voxels, `i j k` a line, whose name ends with the grid's size: `…_30_40_52.txt`. One
folder holds what a camera sees of each object (2.5D), another the full objects (3D), with the same names but for the
sizes.

Source: Yang et al., 3D Object Reconstruction from a Single Depth View with Adversarial Learning (2017);
github.com/Yang7879/3D-RecGAN, `tools.py`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from service.core.arrays import GRID_SIZE, Occupancy
from service.core.grids import pack_bits
from training.data.store import Store, StoreError

_SIZED = re.compile(r"(?P<view>.+)_(?P<x>\d+)_(?P<y>\d+)_(?P<z>\d+)\.txt")
_TURNED = re.compile(r"(?P<object>.+?)_\d_\d_\d")
"""An object in one of its rotations, five about each axis."""


@dataclass(frozen=True)
class RecGanViews:
    """The views of every object.

    Attributes:
        objects: For each object's name the pairs (2.5D file, 3D file) of its views, both in order of their names.
    """

    objects: dict[str, list[tuple[Path, Path]]]

    def __len__(self) -> int:
        return sum(map(len, self.objects.values()))

    @classmethod
    def find(cls, seen: Path, full: Path) -> RecGanViews:
        """Pair the files of two folders by name.

        Args:
            seen: Folder of 2.5D grids.
            full: Folder of 3D grids. Where it has one for an object rather than for each rotation, that is every
                view's.

        Raises:
            StoreError: A folder is missing or holds no grid, or a view has no full shape.
        """
        partial, whole = _grids_in(seen), _grids_in(full)
        objects: dict[str, list[tuple[Path, Path]]] = {}
        for view, path in partial.items():
            turned = _TURNED.fullmatch(view)
            name = turned["object"] if turned else view
            if view not in whole and name not in whole:
                raise StoreError(f"{full} holds no full shape of {path.name}")
            objects.setdefault(name, []).append((path, whole.get(view) or whole[name]))
        return cls(objects)

    def write(self, store: Store) -> None:
        """Put them into a store, a group an object, laid out as in the `views` set.

        Axes are kept as released. Free space is not told: `free` is empty, and there is no length in metres (NaN).

        Raises:
            StoreError: A file is no grid.
        """
        for index, (name, pairs) in enumerate(self.objects.items()):
            observed = np.stack([pack_bits(read_grid(partial)) for partial, _ in pairs])
            store.write_group(
                index,
                {
                    "observed": observed,
                    "free": np.zeros_like(observed),
                    "truth": np.stack([pack_bits(read_grid(whole)) for _, whole in pairs]),
                    "family": np.array(name),
                    "sample": np.array([[row, np.nan] for row in range(len(pairs))], np.float32),
                },
            )
        store.write_manifest({"set": "3d-recgan", "groups": len(self.objects)})


def read_grid(path: Path) -> Occupancy:
    """One text file, in the middle of 64³ voxels; a larger grid loses what lies outside of its middle, as theirs do.

    Raises:
        StoreError: The file is missing, its name says no size, or its lines are no voxels of such a grid.
    """
    named = _SIZED.fullmatch(path.name)
    if named is None:
        raise StoreError(f"{path}: the name says no size; expected …_X_Y_Z.txt")
    size = np.array([int(named[axis]) for axis in "xyz"])
    try:
        lines = [line.split() for line in path.read_text("utf-8").splitlines() if line.strip()]
        voxels = np.array(lines, np.float64).reshape(-1, 3).astype(np.int64)
    except (OSError, ValueError) as error:
        raise StoreError(f"{path} is no list of voxels, three numbers a line: {error}") from error
    if len(voxels) == 0 or voxels.min() < 0 or (voxels >= size).any():
        raise StoreError(f"{path}: {len(voxels)} voxels, not all of them within {size.tolist()}")
    # as their padding and cropping do, each rounded down
    placed = voxels + np.where(size > GRID_SIZE, -((size - GRID_SIZE) // 2), (GRID_SIZE - size) // 2)
    placed = placed[((placed >= 0) & (placed < GRID_SIZE)).all(axis=1)]
    occupancy = np.zeros((GRID_SIZE,) * 3, np.bool_)
    occupancy[tuple(placed.T)] = True
    return occupancy


def _grids_in(folder: Path) -> dict[str, Path]:
    """The grids of a folder by name without size, in order."""
    if not folder.is_dir():
        raise StoreError(f"there is no folder {folder}")
    found = {}
    for path in sorted(folder.glob("*.txt")):
        if named := _SIZED.fullmatch(path.name):
            found[named["view"]] = path
    if not found:
        raise StoreError(f"{folder} holds no grid, a text file with its size in the name: …_X_Y_Z.txt")
    return found
