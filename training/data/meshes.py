"""The `meshes` set: somebody's own objects, from mesh files, under random pushes."""

from __future__ import annotations

import functools
import hashlib
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from training.data.everyday import EverydayConfig, draw_samples
from training.data.generate import Dropped
from training.simulation.mesh import MeshError, mesh_shape
from training.simulation.shapes import Shape

SUFFIXES = (".stl", ".obj", ".ply", ".glb", ".gltf", ".off")
"""What is taken for a mesh in a folder."""

DIGEST = 16
"""Hex digits of a file's sha256 that tell versions of it apart."""


@dataclass(frozen=True)
class MeshesConfig:
    """What is drawn for each body.

    Attributes:
        folder: Where the files are.
        files: Name and digest of each, so that a set does not go on with meshes that were changed.
        unit_m: Length of the files' unit in metres; only proportions count for the samples.
        up_axis: Axis of the files that points away from the ground.
        stretched: Range of the factors, drawn log-uniformly along each axis, that make a new body of a mesh from the
            second time it is drawn on: no two real things are alike, and a handful of meshes is a small set.
        pushes: What each body is pushed with, and the seed.
    """

    folder: str
    files: tuple[tuple[str, str], ...]
    unit_m: float = 1.0
    up_axis: Literal["x", "y", "z"] = "z"
    stretched: tuple[float, float] = (0.8, 1.25)
    pushes: EverydayConfig = field(default_factory=EverydayConfig)


def meshes_in(
    folder: Path, unit_m: float = 1.0, up_axis: Literal["x", "y", "z"] = "z", seed: int = 0
) -> MeshesConfig:
    """The set of all meshes of a folder and those below it.

    Raises:
        MeshError: There is none.
    """
    paths = sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES)
    if not paths:
        raise MeshError(f"{folder} holds no mesh: {', '.join(SUFFIXES)}")
    files = tuple(
        (path.relative_to(folder).as_posix(), hashlib.sha256(path.read_bytes()).hexdigest()[:DIGEST]) for path in paths
    )
    return MeshesConfig(str(folder), files, unit_m, up_axis, pushes=EverydayConfig(seed=seed))


def draw_group(config: MeshesConfig, index: int) -> dict[str, np.ndarray]:
    """Body number `index` with all its samples: each mesh in turn, as it is and then stretched.

    Raises:
        Dropped: The mesh is no body, or the draw gives no sample.
    """
    rng = np.random.default_rng(np.random.SeedSequence((config.pushes.seed, index)))
    name, _ = config.files[index % len(config.files)]
    try:
        with warnings.catch_warnings():
            # Said once to whoever starts the draw, not by each of its processes for each body.
            warnings.simplefilter("ignore", UserWarning)
            shape = _shape(str(Path(config.folder) / name), config.unit_m, config.up_axis)
    except (MeshError, OSError) as error:
        raise Dropped("mesh") from error
    if index >= len(config.files):
        low, high = np.log(config.stretched)
        x, y, z = np.exp(rng.uniform(low, high, 3))
        shape = shape.stretched((float(x), float(y), float(z)))
    return draw_samples(config.pushes, Path(name).stem, shape, config.pushes.cells, rng)


@functools.lru_cache(maxsize=32)
def _shape(path: str, unit_m: float, up_axis: Literal["x", "y", "z"]) -> Shape:
    """Read once in each process: sampling the distance takes seconds."""
    return mesh_shape(path, unit_m, up_axis)
