"""A result as a file, by the suffix of its name."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from service.client.formats.binvox import encode_binvox
from service.client.formats.glb import encode_glb
from service.client.formats.octomap import encode_octomap
from service.client.formats.ply import encode_ply
from service.client.result import Layer, Result
from service.core.archive import npz_bytes
from service.core.arrays import GRID_SIZE, Occupancy
from service.core.grids import Grid


def save(result: Result, path: Path, layer: Layer = "deformed", push: int = 0) -> Path:
    """Write a result.

    Args:
        result: What to write.
        path: Its suffix is one of `SUFFIXES`.
        layer: Which body a file of one body holds.
        push: After which push.

    Returns:
        `path`.

    Raises:
        ValueError: Another suffix.
        NotInReply: The layer was not asked for.
        OSError: The file cannot be written.
    """
    write = _WRITERS.get(path.suffix.lower())
    if write is None:
        raise ValueError(f"{path.name}: files end in {', '.join(SUFFIXES)}")
    path.write_bytes(write(result, layer, push))
    return path


def npz(result: Result) -> bytes:
    """All there is, as the service's own archive (`Accept: application/x-npz`) has it; loads along the first axis."""
    meta: dict[str, Any] = {
        "request_id": result.request_id,
        "model": dict(zip(("name", "version"), result.model, strict=True)),
        "flags": sorted(result.flags),
        "load_flags": [sorted(push.flags) for push in result],
        "timing_ms": result.timing_ms,
    }
    if result.reconstruction_id is not None:
        meta["reconstruction_id"] = result.reconstruction_id
    arrays: dict[str, np.ndarray | None] = {
        "meta": np.array(json.dumps(meta)),
        "voxel_size_m": np.array(result.grid.pitch_m),
        "camera_from_grid": result.grid.camera_from_grid,
        "observed": result.seen,
        "reconstruction": result.body,
        "reconstruction_probability": _half(result.body_probability),
        "deformed": _stacked([push.occupancy for push in result]),
        "probability": _half(_stacked([push.probability for push in result])),
        "displacement_m": _stacked([push.displacement_m for push in result]),
    }
    for name in ("max_displacement_m", "mean_displacement_m", "load_number"):
        arrays[name] = np.array([getattr(push, name) for push in result])
    return npz_bytes({name: array for name, array in arrays.items() if array is not None})


def _stacked(grids: list[np.ndarray | None]) -> np.ndarray | None:
    there = [grid for grid in grids if grid is not None]
    return np.stack(there) if there else None


def _half(probability: np.ndarray | None) -> np.ndarray | None:
    return None if probability is None else probability.astype(np.float16)


def ply(result: Result, layer: Layer = "deformed", push: int = 0) -> bytes:
    """The surface of a layer, camera frame, metres; of a deformed body with the displacement that brought it there."""
    mesh = result.mesh(layer, push)
    moved = None
    if layer == "deformed" and result[push].displacement is not None:
        moved = np.nan_to_num(result.displacement_at(mesh.vertices_m, "deformed", push))
    return encode_ply(mesh.vertices_m, mesh.faces, moved)


def octomap(result: Result, layer: Layer = "deformed", push: int = 0) -> bytes:
    """OctoMap's `.bt`, camera frame: the cells of a lattice along the camera's axes whose centres are in the body."""
    return encode_octomap(cells_along_camera(result.occupancy(layer, push), result.grid), result.grid.pitch_m)


def cells_along_camera(occupancy: Occupancy, grid: Grid) -> np.ndarray:
    """Cells (n × 3) of a lattice along the camera's axes, at the grid's own pitch, whose centres lie in the body.

    Cell (i, j, k) has its centre at ((i+½), (j+½), (k+½)) · pitch in the camera frame.
    """
    filled = np.argwhere(occupancy)
    if len(filled) == 0:
        return np.empty((0, 3), np.int64)
    # The box around the body's voxels, corners included, in the camera frame.
    low, high = filled.min(axis=0), filled.max(axis=0) + 1
    corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij"), axis=-1).reshape(-1, 3)
    seen = corners @ grid.camera_from_grid[:3, :3].T + grid.camera_from_grid[:3, 3] / grid.pitch_m
    axes = [np.arange(np.floor(start), np.ceil(end)) for start, end in zip(seen.min(0), seen.max(0), strict=True)]
    cells = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    voxels = np.floor(
        (cells + 0.5 - grid.camera_from_grid[:3, 3] / grid.pitch_m) @ grid.camera_from_grid[:3, :3]
    ).astype(np.int64)
    inside = ((voxels >= 0) & (voxels < GRID_SIZE)).all(axis=1)
    x, y, z = np.where(inside[:, None], voxels, 0).T
    return np.asarray(cells[inside & occupancy[x, y, z]], np.int64)


def binvox(result: Result, layer: Layer = "deformed", push: int = 0) -> bytes:
    """Binvox, in the grid's own frame, metres: the format knows no rotation."""
    return encode_binvox(result.occupancy(layer, push), result.grid.edge_m)


_WRITERS: dict[str, Callable[[Result, Layer, int], bytes]] = {
    ".npz": lambda result, layer, push: npz(result),
    ".ply": ply,
    ".glb": lambda result, layer, push: encode_glb(result),
    ".bt": octomap,
    ".binvox": binvox,
}
SUFFIXES = tuple(_WRITERS)
"""Kinds of file that `save` writes."""
