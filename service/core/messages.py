"""What a robot asks and what it gets back, free of any wire."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from jaxtyping import Float32, Shaped

from service.core.arrays import Occupancy, Probability, Transform, Vector3
from service.core.camera import Intrinsics
from service.core.grids import Grid, on_grid
from service.core.materials import Material

Displacement: TypeAlias = Float32[np.ndarray, "axis=3 x=64 y=64 z=64"]
"""A vector at each voxel, in grid axes."""


@dataclass(frozen=True)
class EncodedImage:
    """Bytes of a depth image or mask as they came in.

    Attributes:
        encoding: Depth: `png16`, `npy`, `16UC1`, `32FC1` or `compressedDepth`; mask: `png8`.
        data: The bytes.
        unit_m: Metres per count; None for the encoding's default (0.001 for integers, 1.0 for floats).
    """

    encoding: str
    data: bytes
    unit_m: float | None = None


@dataclass(frozen=True)
class Observation:
    """One depth frame and what the robot knows about it.

    Attributes:
        intrinsics: The camera.
        depth: Encoded depth image.
        mask: Encoded mask of the object, or None to segment it.
        up: Direction against gravity in the camera frame (any length), or None to take it from the support plane.
        roi: (u, v, width, height) in pixels that the object is searched in, or None for the whole image.
    """

    intrinsics: Intrinsics
    depth: EncodedImage
    mask: EncodedImage | None = None
    up: Vector3 | None = None
    roi: tuple[int, int, int, int] | None = None


@dataclass(frozen=True)
class KnownShape:
    """A body whose geometry the robot already has.

    Attributes:
        data: 64³ occupancy bits, 32 KiB (`service.core.grids.pack_bits`).
        pitch_m: Edge of one voxel in metres.
        camera_from_grid: Pose of the grid.
        up: Direction against gravity in the camera frame, or None for the grid's own z axis.
    """

    data: bytes
    pitch_m: float
    camera_from_grid: Transform
    up: Vector3 | None = None


@dataclass(frozen=True)
class EarlierReconstruction:
    """What an earlier answer reconstructed, asked again for other loads or another material.

    Attributes:
        reconstruction_id: The `reconstruction_id` of that answer.
    """

    reconstruction_id: str


@dataclass(frozen=True)
class Load:
    """One push: exactly one of `contact_m` (camera frame, metres) and `contact_px` (u, v) is given.

    Attributes:
        force_n: Force vector in newtons, camera frame.
        patch_radius_m: Radius R of the smooth traction patch; None for 0.1 of the edge of the grid answered in.
    """

    force_n: Vector3
    contact_m: Vector3 | None = None
    contact_px: tuple[float, float] | None = None
    patch_radius_m: float | None = None


@dataclass(frozen=True)
class DeformRequest:
    """Attributes:
    source: A depth frame, a shape that is known, or what an earlier answer reconstructed.
    material: Young's modulus and Poisson's ratio.
    loads: One or more pushes, each answered on its own.
    outputs: Any of `reconstruction`, `deformed`, `probability`, `displacement`, `displacement_at_voxels`, `scene`.
    threshold: Occupancy probability above which a voxel counts as filled; None for the models' own. An earlier
        reconstruction stays as it is: there it is of the deformed shapes alone.
    uncertainty_samples: Number of latent samples behind the probabilities; 0 for the mean alone.
    """

    source: Observation | KnownShape | EarlierReconstruction
    material: Material
    loads: tuple[Load, ...]
    outputs: frozenset[str] = frozenset({"reconstruction", "deformed"})
    threshold: float | None = None
    uncertainty_samples: int = 0


@dataclass(frozen=True)
class LoadResult:
    """Attributes:
    deformed: Occupancy after the push, in the reply's grid.
    probability: Occupancy probability behind `deformed`.
    moved_m: At each voxel of the deformed body, in C order, the displacement (grid axes) of the material now there.
    max_displacement_m, mean_displacement_m: Over the deformed body.
    load_number: F/(E L²) with L the edge of the grid.
    flags: What the robot should know about this answer.
    """

    deformed: Occupancy
    probability: Probability
    moved_m: Float32[np.ndarray, "axis=3 n"]
    max_displacement_m: float
    mean_displacement_m: float
    load_number: float
    flags: frozenset[str]

    @property
    def displacement_m(self) -> Displacement:
        """`moved_m` as a grid. Made anew each time: it is larger than all else together."""
        return self.as_grid(self.moved_m)

    def as_grid(self, vectors: Shaped[np.ndarray, "axis=3 n"]) -> Shaped[np.ndarray, "axis=3 x=64 y=64 z=64"]:
        """Vectors of the deformed body's voxels, those in C order, on a grid that is zero outside it."""
        return on_grid(vectors, self.deformed)


@dataclass(frozen=True)
class DeformResult:
    """All grids share `grid`: the body grid or a known shape's own, z up, its floor on the support plane.

    `observed` is None for a known shape. `reconstruction_id` asks for the same body again, None where none are kept.
    `timing_ms` maps each stage of the pipeline to its wall time.
    """

    grid: Grid
    observed: Occupancy | None
    reconstruction: Occupancy
    reconstruction_probability: Probability
    loads: tuple[LoadResult, ...]
    flags: frozenset[str]
    model_name: str
    model_version: str
    reconstruction_id: str | None = None
    timing_ms: dict[str, float] = field(default_factory=dict)
