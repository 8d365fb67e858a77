"""JSON of the HTTP API: what a request may hold and what a reply holds.

The models check form only (names, types, numbers of components). What the numbers mean is checked once, where they
become a `DeformRequest` (`service.api.convert`), so that both wires refuse the same things with the same words.
"""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, WithJsonSchema

# NaN and infinities pass here where `service.core` has its own, better named error for them.
AnyFloat = Annotated[float, Field(allow_inf_nan=True)]
Vector = tuple[float, float, float]
Row = tuple[float, float, float, float]
Matrix = tuple[Row, Row, Row, Row]

Output = Literal["reconstruction", "deformed", "probability", "displacement", "scene"]


# Decoded while the JSON is parsed, which is four times as fast as a string decoded afterwards.
Base64 = Annotated[bytes, WithJsonSchema({"type": "string", "contentEncoding": "base64"})]


class _Request(BaseModel):
    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, val_json_bytes="base64"
    )


class CameraBody(_Request):
    """Pinhole intrinsics in pixels; pixel centres at integer coordinates, as in OpenCV and ROS."""

    fx: AnyFloat = Field(description="Focal length along u, positive.", examples=[615.0])
    fy: AnyFloat = Field(description="Focal length along v, positive.", examples=[615.0])
    cx: AnyFloat = Field(description="Principal point, u.", examples=[320.0])
    cy: AnyFloat = Field(description="Principal point, v.", examples=[240.0])
    width: int = Field(description="Image width in pixels.", examples=[640])
    height: int = Field(description="Image height in pixels.", examples=[480])
    distortion: list[AnyFloat] | None = Field(
        None, description="OpenCV's coefficients (4, 5, 8, 12 or 14); null for a rectified image."
    )


class DepthBody(_Request):
    """A depth image. 0 in integer images and NaN or ±Inf in float ones are no readings (REP 117, 118)."""

    encoding: str = Field(
        max_length=100,
        description="`png16`: 16-bit grey PNG; `npy`: NumPy file; `16UC1`, `32FC1`: rows of little-endian pixels; "
        "`compressedDepth`, or the format string of such a ROS message: its payload.",
        examples=["png16", "npy", "16UC1", "32FC1", "compressedDepth"],
    )
    unit_m: AnyFloat | None = Field(
        None, description="Metres per count; null for 0.001 in integer images and 1.0 in float ones."
    )
    data: Base64 | None = Field(None, description="Base64; absent in multipart requests.")


class MaskBody(_Request):
    """Pixels of the object: any value but 0."""

    encoding: str = Field("png8", max_length=100, description="`png8`: 8-bit grey PNG.")
    data: Base64 | None = Field(None, description="Base64; absent in multipart requests.")


class ShapeBody(_Request):
    """A body whose geometry the robot already has, in place of `depth`."""

    encoding: Literal["bits"] = Field(
        "bits", description="64³ voxels indexed [x, y, z], C order, least significant bit first: 32 KiB."
    )
    data: Base64 = Field(description="Base64.")
    voxel_size_m: AnyFloat = Field(description="Edge of one voxel in metres, positive.")
    camera_from_grid: tuple[
        tuple[AnyFloat, AnyFloat, AnyFloat, AnyFloat],
        tuple[AnyFloat, AnyFloat, AnyFloat, AnyFloat],
        tuple[AnyFloat, AnyFloat, AnyFloat, AnyFloat],
        tuple[AnyFloat, AnyFloat, AnyFloat, AnyFloat],
    ] = Field(description="Rigid 4×4 transform, row by row.")


class MaterialBody(_Request):
    """Either `name`, one of `GET /v1/materials`, or both numbers."""

    name: str | None = Field(None, description="A named material.", examples=["silicone"])
    young_modulus_pa: AnyFloat | None = Field(None, description="Young's modulus in Pa, positive.")
    poisson_ratio: AnyFloat | None = Field(
        None, description="Poisson's ratio, 0 to 0.5; above 0.49 it is answered as 0.49 with a flag."
    )


class LoadBody(_Request):
    """One push: a force on a smooth patch of the surface. Exactly one of `contact_m` and `contact_px`."""

    force_n: Vector = Field(description="Force in newtons, camera frame; zero is answered: nothing moves.")
    contact_m: Vector | None = Field(None, description="Contact in metres, camera frame.")
    contact_px: tuple[float, float] | None = Field(
        None, description="Contact as a pixel (u, v): the depth surface there."
    )
    patch_radius_m: float | None = Field(
        None, gt=0.0, description="Radius of the patch that carries the force; null for 0.1 of the grid's edge."
    )


class DeformBody(_Request):
    """A depth frame (or a known shape), what the object is made of, and the pushes to try on it."""

    camera: CameraBody | None = Field(None, description="Needed with `depth`.")
    depth: DepthBody | None = Field(None, description="Exactly one of `depth`, `shape` and `reconstruction_id`.")
    mask: MaskBody | None = Field(None, description="Pixels of the object; null to find it.")
    up: tuple[AnyFloat, AnyFloat, AnyFloat] | None = Field(
        None, description="Direction against gravity in the camera frame, any length; null to find the support plane."
    )
    roi: tuple[int, int, int, int] | None = Field(
        None, description="(u, v, width, height) in pixels in which the object is searched; null for the whole image."
    )
    shape: ShapeBody | None = Field(None, description="Exactly one of `depth`, `shape` and `reconstruction_id`.")
    reconstruction_id: str | None = Field(
        None,
        min_length=1,
        max_length=64,
        description="Exactly one of `depth`, `shape` and `reconstruction_id`: that of an earlier reply, whose body is "
        "asked again. Kept for a bounded time and memory; once it is gone the error is `reconstruction_gone`.",
    )
    material: MaterialBody
    loads: list[LoadBody] = Field(min_length=1, description="Each is answered on its own.")
    outputs: list[Output] = Field(
        default=["reconstruction", "deformed"], description="Which grids and fields the reply carries."
    )
    displacement_form: Literal["grid", "voxels"] = Field(
        "grid",
        description="How displacements travel: `grid`, on all voxels, or `voxels`, on those of the deformed body "
        "alone, a thirtieth of the bytes; then `deformed`, which says where they are, must be among the outputs.",
    )
    threshold: float | None = Field(
        None,
        gt=0.0,
        lt=1.0,
        description="Occupancy probability above which a voxel is filled; null for the models'. With "
        "`reconstruction_id` it is of the deformed shapes alone.",
    )
    uncertainty_samples: int = Field(
        0, ge=0, le=64, description="Latent samples behind the probabilities; 0 for the mean alone."
    )


class ModelReply(BaseModel):
    """The networks that answered."""

    name: str
    version: str


class GridReply(BaseModel):
    """Where every grid of the reply sits: z up, floor on the support."""

    shape: tuple[int, int, int] = Field(description="Always [64, 64, 64]; arrays are indexed [x, y, z], C order.")
    voxel_size_m: float = Field(description="Edge of one voxel in metres.")
    camera_from_grid: Matrix = Field(description="Rigid 4×4 transform from the grid's metric frame to the camera's.")


class BitsReply(BaseModel):
    """Occupied voxels."""

    encoding: Literal["bits"] = Field(description="One bit a voxel, C order, least significant bit first: 32 KiB.")
    data: str = Field(description="Base64.")


class ProbabilityReply(BaseModel):
    """Occupancy probabilities."""

    encoding: Literal["uint8"] = Field(description="Probability = value / 255.")
    shape: tuple[int, int, int]
    data: str = Field(description="Base64.")


class DisplacementReply(BaseModel):
    """Displacement of the material now at each voxel of the deformed body, metres, along the grid's axes."""

    encoding: Literal["float16"] = Field(description="Little-endian half precision.")
    shape: tuple[int, int, int, int] = Field(description="Always [3, 64, 64, 64]: axis, x, y, z.")
    data: str = Field(description="Base64.")


class DisplacementAtVoxelsReply(BaseModel):
    """The same at the n voxels set in `deformed` alone, in the order in which they are set there."""

    encoding: Literal["float16"] = Field(description="Little-endian half precision.")
    shape: tuple[int, int] = Field(description="[3, n]: axis, voxel.")
    data: str = Field(description="Base64.")


class SceneReply(BaseModel):
    """The surfaces, metres in the camera's frame: nodes `reconstruction` and `load <i>`, coloured by displacement."""

    encoding: Literal["glb"] = Field(description="Binary glTF 2.0.")
    data: str = Field(description="Base64.")


class LoadReply(BaseModel):
    """The answer to one push."""

    deformed: BitsReply | None = None
    probability: ProbabilityReply | None = None
    displacement: DisplacementReply | None = None
    displacement_at_voxels: DisplacementAtVoxelsReply | None = Field(
        None, description="In place of `displacement` where `displacement_form` is `voxels`."
    )
    max_displacement_m: float = Field(description="Largest displacement over the deformed body.")
    mean_displacement_m: float
    load_number: float = Field(description="F / (E L²), L the edge of the grid.")
    flags: list[str] = Field(description="What the robot should know about this answer.")


class DeformReply(BaseModel):
    """The object's full shape and the shapes it takes; grids that were not asked for are absent."""

    request_id: str
    reconstruction_id: str | None = Field(
        None, description="Asks for the same body again; absent where the service keeps none."
    )
    model: ModelReply
    grid: GridReply
    observed: BitsReply | None = Field(None, description="Voxels seen by the camera; absent for a known shape.")
    reconstruction: BitsReply | None = None
    reconstruction_probability: ProbabilityReply | None = None
    loads: list[LoadReply] = Field(description="In the order of the request.")
    flags: list[str]
    scene: SceneReply | None = None
    timing_ms: dict[str, float] = Field(description="Wall time of each stage.")


class MaterialReply(BaseModel):
    """A named material."""

    name: str
    young_modulus_pa: float
    poisson_ratio: float
    young_modulus_range_pa: tuple[float, float]
    description: str
    source: str


class MaterialsReply(BaseModel):
    materials: list[MaterialReply]


class ProblemReply(BaseModel):
    """An RFC 9457 problem document."""

    type: str = Field(description="`/problems/` and the code.")
    title: str
    status: int
    detail: str = Field(description="One sentence for a person.")
    code: str = Field(description="Stable name of the error.")
    field: str | None = Field(None, description="Path of the offending field, such as `loads[0].contact_m`.")
    expected: str | float | list[str] | None = None
    actual: str | float | None = None
    errors: list[dict[str, str]] | None = Field(None, description="Further fields in error.")
    request_id: str
