"""Between the wire and `service.core.messages`: requests in, replies out. The only place where either is translated."""

from __future__ import annotations

import base64
import io
import json
import zipfile
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import ValidationError
from pydantic_core import to_json

from service.api.problem import validation_failed
from service.api.scene import scene_glb
from service.api.schemas import DeformBody, LoadBody, MaterialBody, ShapeBody
from service.core.arrays import GRID_SIZE, Occupancy, Vector3
from service.core.camera import make_intrinsics, parse_up
from service.core.errors import InvalidFrame, InvalidRequest
from service.core.grids import pack_bits
from service.core.materials import Material, material, material_named
from service.core.messages import (
    DeformRequest,
    DeformResult,
    EarlierReconstruction,
    EncodedImage,
    KnownShape,
    Load,
    LoadResult,
    Observation,
)

HEAVY_FIELDS = 4
"""Replies with more grids of floats or loads than this are encoded beside the event loop, not on it."""

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_NPY_SIGNATURE = b"\x93NUMPY"


# --- requests ---------------------------------------------------------------------------------------------------


def parse_body(data: bytes) -> DeformBody:
    """A JSON document as a request body whose form is right.

    Raises:
        ValidationFailed: It is not JSON, or a field is missing, unknown or of the wrong form.
    """
    try:
        return DeformBody.model_validate_json(data)
    except ValidationError as failure:
        raise validation_failed(failure) from None


def deform_request(body: DeformBody, max_loads: int, files: Mapping[str, bytes] | None = None) -> DeformRequest:
    """What the body asks for.

    Args:
        body: The request.
        max_loads: Most loads in one request.
        files: Parts `depth` and `mask` of a multipart request; None where images are in the body as base64.

    Raises:
        InvalidRequest: Or one of its kin, with the path of the offending field.
    """
    check_load_count(len(body.loads), max_loads)
    return DeformRequest(
        source=_source(body, files),
        material=_material(body.material),
        loads=tuple(_load(load, f"loads[{index}]") for index, load in enumerate(body.loads)),
        outputs=frozenset(body.outputs),
        threshold=body.threshold,
        uncertainty_samples=body.uncertainty_samples,
    )


def check_load_count(count: int, max_loads: int) -> None:
    """Refuse more loads than one request may carry.

    Raises:
        InvalidRequest: There are more.
    """
    if count > max_loads:
        raise InvalidRequest(
            f"A request may carry {max_loads} loads; send the others in further requests.",
            field="loads",
            expected=f"at most {max_loads}",
            actual=count,
        )


def _source(body: DeformBody, files: Mapping[str, bytes] | None) -> Observation | KnownShape | EarlierReconstruction:
    given = {
        "depth": body.depth is not None or "depth" in (files or {}),
        "shape": body.shape is not None,
        "reconstruction_id": body.reconstruction_id is not None,
    }
    if sum(given.values()) != 1:
        raise InvalidRequest(
            "Send `depth`, one depth image, `shape`, a known geometry, or the `reconstruction_id` of an earlier reply.",
            field="depth",
            expected="exactly one of depth, shape and reconstruction_id",
            actual=" and ".join(name for name, there in given.items() if there) or "none",
        )
    if body.shape is not None:
        return _known_shape(body, body.shape, files)
    if body.reconstruction_id is not None:
        return _earlier(body, body.reconstruction_id, files)
    return _observation(body, files)


def _earlier(body: DeformBody, reconstruction_id: str, files: Mapping[str, bytes] | None) -> EarlierReconstruction:
    for name in ("camera", "mask", "up", "roi"):
        if getattr(body, name) is not None or name in (files or {}):
            raise InvalidRequest(
                f"An earlier reconstruction is asked again as it is: it takes no `{name}`.",
                field=name, expected="no such field",
            )  # fmt: skip
    return EarlierReconstruction(reconstruction_id)


def _observation(body: DeformBody, files: Mapping[str, bytes] | None) -> Observation:
    if body.camera is None:
        raise InvalidRequest("`camera` is missing: a depth image has no scale without it.", field="camera")
    camera = body.camera
    intrinsics = make_intrinsics(
        camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, camera.distortion
    )
    depth_data = _image_bytes("depth", body.depth.data if body.depth else None, files)
    if body.depth is not None:
        depth = EncodedImage(body.depth.encoding, depth_data, body.depth.unit_m)
    else:
        depth = EncodedImage(_guess_encoding(depth_data), depth_data)
    mask = None
    if body.mask is not None or "mask" in (files or {}):
        encoding = body.mask.encoding if body.mask else "png8"
        mask = EncodedImage(encoding, _image_bytes("mask", body.mask.data if body.mask else None, files))
    up = None if body.up is None else parse_up(body.up)
    return Observation(intrinsics, depth, mask, up, body.roi)


def _guess_encoding(data: bytes) -> str:
    """Of a depth file that came without one; files of these two kinds say it themselves."""
    if data.startswith(_PNG_SIGNATURE):
        return "png16"
    if data.startswith(_NPY_SIGNATURE):
        return "npy"
    raise InvalidFrame(
        "The depth file is neither PNG nor NumPy; name its encoding in `depth.encoding` of the `request` part.",
        field="depth.encoding",
    )


def _image_bytes(name: str, data: bytes | None, files: Mapping[str, bytes] | None) -> bytes:
    if files is None:
        if data is None:
            raise InvalidRequest(f"`{name}.data` is missing.", field=f"{name}.data", expected="base64")
        return data
    if data is not None:
        raise InvalidRequest(
            f"In a multipart request the image is the file part `{name}`, not `{name}.data`.", field=f"{name}.data"
        )
    if name not in files:
        raise InvalidRequest(f"The file part `{name}` is missing.", field=name, expected="a file part")
    return files[name]


def _known_shape(body: DeformBody, shape: ShapeBody, files: Mapping[str, bytes] | None) -> KnownShape:
    if body.mask is not None or files:
        raise InvalidRequest("A known shape takes no mask and no files.", field="mask")
    up = None if body.up is None else parse_up(body.up)
    return KnownShape(shape.data, shape.voxel_size_m, np.array(shape.camera_from_grid, np.float64), up)


def _material(body: MaterialBody) -> Material:
    numbers = (body.young_modulus_pa, body.poisson_ratio)
    if body.name is not None:
        if numbers != (None, None):
            raise InvalidRequest(
                "Give the material either by its name or by its numbers.", field="material", expected="one of the two"
            )
        return material_named(body.name)
    if body.young_modulus_pa is None or body.poisson_ratio is None:
        missing = "young_modulus_pa" if body.young_modulus_pa is None else "poisson_ratio"
        raise InvalidRequest(
            f"`material.{missing}` is missing: a material is a name or both numbers.", field=f"material.{missing}"
        )
    return material(body.young_modulus_pa, body.poisson_ratio)


def _load(body: LoadBody, field: str) -> Load:
    if (body.contact_m is None) == (body.contact_px is None):
        raise InvalidRequest(
            "A load has its contact either in metres or as a pixel.",
            field=field,
            expected="exactly one of contact_m and contact_px",
            actual="neither" if body.contact_m is None else "both",
        )
    contact_m = None if body.contact_m is None else _vector(body.contact_m)
    return Load(_vector(body.force_n), contact_m, body.contact_px, body.patch_radius_m)


def _vector(components: tuple[float, float, float]) -> Vector3:
    return np.array(components, np.float64)


# --- replies ----------------------------------------------------------------------------------------------------


def is_heavy(request: DeformRequest) -> bool:
    """Whether the reply is better encoded beside the event loop."""
    if "scene" in request.outputs:
        return True
    fields = len(request.loads) * len(request.outputs & {"probability", "displacement"})
    return max(fields, len(request.loads)) > HEAVY_FIELDS


def reply_document(result: DeformResult, outputs: frozenset[str], request_id: str) -> dict[str, Any]:
    """The reply as in `service.api.schemas.DeformReply`, but for `timing_ms`, which ends with the encoding itself."""
    grid = result.grid
    document: dict[str, Any] = {"request_id": request_id}
    if result.reconstruction_id is not None:
        document["reconstruction_id"] = result.reconstruction_id
    document |= {
        "model": {"name": result.model_name, "version": result.model_version},
        "grid": {
            "shape": [GRID_SIZE] * 3,
            "voxel_size_m": grid.pitch_m,
            "camera_from_grid": grid.camera_from_grid.tolist(),
        },
    }
    if "reconstruction" in outputs:
        if result.observed is not None:
            document["observed"] = _bits(result.observed)
        document["reconstruction"] = _bits(result.reconstruction)
        if "probability" in outputs:
            document["reconstruction_probability"] = _probability(result.reconstruction_probability)
    document["loads"] = [_load_document(load, outputs) for load in result.loads]
    document["flags"] = sorted(result.flags)
    if "scene" in outputs:
        document["scene"] = {"encoding": "glb", "data": base64.b64encode(scene_glb(result)).decode("ascii")}
    return document


def _load_document(load: LoadResult, outputs: frozenset[str]) -> dict[str, Any]:
    document: dict[str, Any] = {}
    if "deformed" in outputs:
        document["deformed"] = _bits(load.deformed)
    if "probability" in outputs:
        document["probability"] = _probability(load.probability)
    if "displacement" in outputs:
        field = half_precision(load.displacement_m)
        document["displacement"] = {"encoding": "float16", "shape": list(field.shape), "data": _base64(field)}
    document["max_displacement_m"] = load.max_displacement_m
    document["mean_displacement_m"] = load.mean_displacement_m
    document["load_number"] = load.load_number
    document["flags"] = sorted(load.flags)
    return document


def _bits(occupancy: Occupancy) -> dict[str, Any]:
    return {"encoding": "bits", "data": _base64(pack_bits(occupancy))}


def _probability(probability: np.ndarray) -> dict[str, Any]:
    found = levels(probability)
    return {"encoding": "uint8", "shape": list(found.shape), "data": _base64(found)}


def levels(probability: np.ndarray) -> np.ndarray:
    """Probabilities as bytes, value/255: what both wires send."""
    return np.rint(probability * np.float32(255.0)).astype(np.uint8)


def half_precision(displacement_m: np.ndarray) -> np.ndarray:
    """A displacement field as both wires send it: little-endian half precision, metres."""
    return displacement_m.astype("<f2")


def _base64(array: np.ndarray) -> str:
    return base64.b64encode(np.ascontiguousarray(array).data).decode("ascii")


def reply_json(document: Mapping[str, Any], timing_ms: Mapping[str, float]) -> bytes:
    """The document with its timings as UTF-8 JSON."""
    return to_json({**document, "timing_ms": timing_ms}, inf_nan_mode="null")


def reply_npz(
    result: DeformResult, outputs: frozenset[str], request_id: str, timing_ms: Mapping[str, float]
) -> bytes:
    """The same as arrays of a NumPy archive, loads stacked along the first axis.

    `voxel_size_m` and `camera_from_grid`; where asked for `observed`, `reconstruction` (bool 64³), `deformed`
    (bool n×64³), `reconstruction_probability` and `probability` (float16), `displacement_m` (float16 n×3×64³);
    `max_displacement_m`, `mean_displacement_m`, `load_number` (n); `scene` (bytes of a binary glTF); the rest as JSON
    in the string `meta`.
    """
    meta = {
        "request_id": request_id,
        "reconstruction_id": result.reconstruction_id,
        "model": {"name": result.model_name, "version": result.model_version},
        "flags": sorted(result.flags),
        "load_flags": [sorted(load.flags) for load in result.loads],
        "timing_ms": timing_ms,
    }
    arrays: dict[str, np.ndarray] = {
        "meta": np.array(json.dumps(meta)),
        "voxel_size_m": np.array(result.grid.pitch_m),
        "camera_from_grid": result.grid.camera_from_grid,
        "max_displacement_m": np.array([load.max_displacement_m for load in result.loads]),
        "mean_displacement_m": np.array([load.mean_displacement_m for load in result.loads]),
        "load_number": np.array([load.load_number for load in result.loads]),
    }
    if "reconstruction" in outputs:
        if result.observed is not None:
            arrays["observed"] = result.observed
        arrays["reconstruction"] = result.reconstruction
        if "probability" in outputs:
            arrays["reconstruction_probability"] = result.reconstruction_probability.astype(np.float16)
    if "deformed" in outputs:
        arrays["deformed"] = np.stack([load.deformed for load in result.loads])
    if "probability" in outputs:
        arrays["probability"] = np.stack([load.probability.astype(np.float16) for load in result.loads])
    if "displacement" in outputs:
        arrays["displacement_m"] = np.stack([load.displacement_m.astype(np.float16) for load in result.loads])
    if "scene" in outputs:
        arrays["scene"] = np.frombuffer(scene_glb(result), np.uint8)
    return _npz(arrays)


def _npz(arrays: Mapping[str, np.ndarray]) -> bytes:
    """A NumPy archive at the fastest compression: occupancy shrinks 50-fold at it, and zlib's default costs 5 times."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, array in arrays.items():
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
    return buffer.getvalue()
