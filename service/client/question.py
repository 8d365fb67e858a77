"""What a robot asks, from NumPy arrays: free of any wire, and light enough for a machine without the service."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypedDict, Unpack

import numpy as np

from service.core.arrays import GRID_SIZE
from service.core.materials import Material

Output: TypeAlias = Literal["reconstruction", "deformed", "probability", "displacement"]
OUTPUTS: tuple[Output, ...] = ("reconstruction", "deformed", "probability", "displacement")
DEFAULT_OUTPUTS: tuple[Output, ...] = ("reconstruction", "deformed", "displacement")
"""What `Result` needs for all of its methods."""

Triple: TypeAlias = Sequence[float | int] | np.ndarray
"""Three numbers."""

_PNG = b"\x89PNG\r\n\x1a\n"
_NPY = b"\x93NUMPY"


@dataclass(frozen=True)
class Camera:
    """Pinhole intrinsics in pixels; pixel centres at integer coordinates, as in OpenCV and ROS.

    Attributes:
        fx, fy: Focal lengths.
        cx, cy: Principal point.
        width, height: Size of the image.
        distortion: OpenCV's coefficients (4, 5, 8, 12 or 14); empty for a rectified image.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: tuple[float, ...] = ()

    @classmethod
    def from_json(cls, source: str | Path | Mapping[str, Any]) -> Camera:
        """From a document with these names, or the file that holds one; what else is in it is left out."""
        known = source if isinstance(source, Mapping) else json.loads(Path(source).read_text("utf-8"))
        numbers = {name: float(known[name]) for name in ("fx", "fy", "cx", "cy")}
        distortion = tuple(float(number) for number in known.get("distortion") or ())
        return cls(**numbers, width=int(known["width"]), height=int(known["height"]), distortion=distortion)

    @classmethod
    def from_matrix(
        cls, k: np.ndarray | Sequence[Sequence[float]], width: int, height: int, distortion: Sequence[float] = ()
    ) -> Camera:
        """From OpenCV's 3×3 camera matrix K."""
        matrix = np.asarray(k, np.float64).reshape(3, 3)
        fx, fy, cx, cy = (float(matrix[place]) for place in ((0, 0), (1, 1), (0, 2), (1, 2)))
        return cls(fx, fy, cx, cy, width, height, tuple(float(number) for number in distortion))


@dataclass(frozen=True)
class Image:
    """An image as it travels.

    Attributes:
        encoding: Depth: `png16`, `npy`, `16UC1`, `32FC1`, `compressedDepth` or the format string of such a ROS message;
            mask: `png8`.
        data: The bytes.
        unit_m: Metres per count; None for 0.001 in integer images and 1.0 in float ones.
    """

    encoding: str
    data: bytes = field(repr=False)
    unit_m: float | None = None


@dataclass(frozen=True)
class Push:
    """A force on a smooth patch of the surface; exactly one of `contact_m` and `contact_px`.

    Attributes:
        force_n: Newtons, camera frame.
        contact_m: Metres, camera frame.
        contact_px: Pixel (u, v): the depth surface there.
        patch_radius_m: Radius of the patch; None for 0.1 of the grid's edge.
    """

    force_n: Triple
    contact_m: Triple | None = None
    contact_px: Sequence[float | int] | np.ndarray | None = None
    patch_radius_m: float | None = None


@dataclass(frozen=True)
class Shape:
    """A body whose geometry is known, in place of a depth image.

    Attributes:
        occupancy: Bool 64×64×64, indexed [x, y, z].
        voxel_size_m: Edge of one voxel.
        camera_from_grid: Rigid 4×4 transform from the grid's metric frame to the camera's.
    """

    occupancy: np.ndarray = field(repr=False)
    voxel_size_m: float
    camera_from_grid: np.ndarray

    @property
    def bits(self) -> bytes:
        """The 32 KiB that travel.

        Raises:
            ValueError: Not 64×64×64.
        """
        if np.shape(self.occupancy) != (GRID_SIZE,) * 3:
            raise ValueError(f"a known shape is {GRID_SIZE}³ voxels, not {np.shape(self.occupancy)}")
        return np.packbits(np.asarray(self.occupancy, np.bool_).ravel(), bitorder="little").tobytes()


@dataclass(frozen=True)
class Earlier:
    """The body that an earlier answer reconstructed (`Result.earlier`), in place of a depth image.

    Attributes:
        reconstruction_id: That of the answer. The service keeps it for a bounded time.
    """

    reconstruction_id: str


Depth: TypeAlias = np.ndarray | Image | str | Path
MaterialLike: TypeAlias = str | Material | tuple[float | int, float | int]


@dataclass(frozen=True)
class Question:
    """A request, complete. `source` is a depth image, a known shape or an earlier body; `camera` goes with the first.

    `material` is a name or (Young's modulus in Pa, Poisson's ratio).
    """

    source: Image | Shape | Earlier
    camera: Camera | None
    pushes: tuple[Push, ...]
    material: str | tuple[float | int, float | int]
    mask: Image | None = None
    up: tuple[float, float, float] | None = None
    roi: tuple[int, int, int, int] | None = None
    outputs: tuple[Output, ...] = field(default=DEFAULT_OUTPUTS)
    threshold: float | None = None
    uncertainty_samples: int = 0


class Options(TypedDict, total=False):
    """What a question may hold beside frame, push and material.

    Attributes:
        mask: Pixels of the object (height × width, any value but 0); found where absent.
        up: Against gravity, camera frame, any length; found where absent and the support is seen.
        roi: (u, v, width, height) in pixels in which the object is searched.
        unit_m: Metres per count of the depth, where not 0.001 (integers) or 1 (floats).
        outputs: What the reply carries; `reconstruction`, `deformed` and `displacement` where absent.
        threshold: Occupancy probability above which a voxel is filled; None for the models' own.
        uncertainty_samples: Latent samples behind the probabilities, 0 to 64.
    """

    mask: np.ndarray | Image | None
    up: Triple | None
    roi: Sequence[int] | np.ndarray | None
    unit_m: float | None
    outputs: Iterable[Output]
    threshold: float | None
    uncertainty_samples: int


def question(
    depth: Depth | Shape | Earlier,
    camera: Camera | None = None,
    push: Push | Iterable[Push] = (),
    material: MaterialLike = "silicone",
    **options: Unpack[Options],
) -> Question:
    """A request from what a robot holds.

    Args:
        depth: Height × width array, uint16 (millimetres, 0 for no reading) or float (metres, NaN for no reading); a
            file (`.png`, `.npy`); an `Image` with the bytes as they came; a `Shape`; or `result.earlier`.
        camera: Intrinsics; needed with a depth image.
        push: One load or several, each answered on its own; many cost little more than one.
        material: A name (`client.materials()`), a `Material`, or (Young's modulus in Pa, Poisson's ratio).
        options: See `Options`.

    Raises:
        ValueError: An array has a type or shape that no image has. What numbers mean is for the service to judge.
    """
    pushes = (push,) if isinstance(push, Push) else tuple(push)
    chosen = material
    if isinstance(material, Material):
        chosen = material.name or (material.young_modulus_pa, material.poisson_ratio)
    assert not isinstance(chosen, Material)
    mask, up, roi = options.get("mask"), options.get("up"), options.get("roi")
    return Question(
        source=depth if isinstance(depth, Shape | Earlier) else depth_image(depth, options.get("unit_m")),
        camera=camera,
        pushes=pushes,
        material=chosen,
        mask=None if mask is None else mask_image(mask),
        up=None if up is None else triple(up),
        roi=None if roi is None else _roi(roi),
        outputs=tuple(options.get("outputs", DEFAULT_OUTPUTS)),
        threshold=options.get("threshold"),
        uncertainty_samples=options.get("uncertainty_samples", 0),
    )


def depth_image(depth: Depth, unit_m: float | None = None) -> Image:
    """A depth image ready to travel: arrays go as raw rows, which cost a robot's CPU nothing.

    Raises:
        ValueError: The array is no image of uint16 or floats, or the file is neither PNG nor npy.
    """
    if isinstance(depth, Image):
        return depth
    if isinstance(depth, str | Path):
        data = Path(depth).read_bytes()
        if data.startswith(_PNG):
            return Image("png16", data, unit_m)
        if data.startswith(_NPY):
            return Image("npy", data, unit_m)
        raise ValueError(f"{depth} is neither PNG nor npy")
    if depth.ndim == 3 and depth.shape[2] == 1:
        depth = depth[..., 0]
    if depth.ndim != 2 or (depth.dtype != np.uint16 and depth.dtype.kind != "f"):
        raise ValueError(f"a depth image is height × width of uint16 or floats, not {depth.shape} of {depth.dtype}")
    encoding, wire = ("16UC1", "<u2") if depth.dtype == np.uint16 else ("32FC1", "<f4")
    # A double too large for a float is no reading, and becomes infinity, which says so.
    with np.errstate(over="ignore"):
        return Image(encoding, np.ascontiguousarray(depth, wire).tobytes(), unit_m)


def mask_image(mask: np.ndarray | Image) -> Image:
    """A mask ready to travel.

    Raises:
        ValueError: The array is not height × width.
    """
    if isinstance(mask, Image):
        return mask
    from service.client.formats.png import encode_grey_png

    if mask.ndim != 2:
        raise ValueError(f"a mask is height × width, not {mask.shape}")
    return Image("png8", encode_grey_png((mask != 0).astype(np.uint8) * np.uint8(255)))


def triple(vector: Triple) -> tuple[float, float, float]:
    """Three numbers as Python's own.

    Raises:
        ValueError: Not three.
    """
    x, y, z = (float(component) for component in np.asarray(vector, np.float64).ravel())
    return x, y, z


def _roi(roi: Sequence[int] | np.ndarray) -> tuple[int, int, int, int]:
    u, v, width, height = (int(number) for number in roi)
    return u, v, width, height
