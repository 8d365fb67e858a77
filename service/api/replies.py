"""From `service.core.messages` to the wire: answers as JSON, NPZ and, by `scene`, glTF. Requests: `convert`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import orjson
import pybase64

from service.api.scene import scene_glb
from service.core.archive import npz_bytes
from service.core.arrays import GRID_SIZE, Occupancy
from service.core.grids import pack_bits
from service.core.messages import DeformRequest, DeformResult, LoadResult

HEAVY_FIELDS = 4
"""Replies with more grids of floats or loads than this are encoded beside the event loop, not on it."""


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
        document["scene"] = {"encoding": "glb", "data": pybase64.b64encode_as_string(scene_glb(result))}
    return document


def _load_document(load: LoadResult, outputs: frozenset[str]) -> dict[str, Any]:
    document: dict[str, Any] = {}
    if "deformed" in outputs:
        document["deformed"] = _bits(load.deformed)
    if "probability" in outputs:
        document["probability"] = _probability(load.probability)
    if "displacement" in outputs:
        field = half_precision(load)
        document["displacement"] = {"encoding": "float16", "shape": list(field.shape), "data": _base64(field)}
    if "displacement_at_voxels" in outputs:
        moved = half_precision_at_voxels(load)
        document["displacement_at_voxels"] = {
            "encoding": "float16", "shape": list(moved.shape), "data": _base64(moved)
        }  # fmt: skip
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


def half_precision(load: LoadResult) -> np.ndarray:
    """Its displacement field as both wires send it: little-endian half precision, metres."""
    # rounded before it becomes a grid, nearly all of which is zero
    return load.as_grid(half_precision_at_voxels(load))


def half_precision_at_voxels(load: LoadResult) -> np.ndarray:
    """The same at the voxels of the deformed body, 3 × n, in C order."""
    return load.moved_m.astype("<f2")


def _base64(array: np.ndarray) -> str:
    return pybase64.b64encode_as_string(np.ascontiguousarray(array).data)


def reply_json(document: Mapping[str, Any], timing_ms: Mapping[str, float]) -> bytes:
    """The document with its timings as UTF-8 JSON, in which what is no number is null."""
    return orjson.dumps({**document, "timing_ms": timing_ms}, option=orjson.OPT_SERIALIZE_NUMPY)


def reply_npz(
    result: DeformResult, outputs: frozenset[str], request_id: str, timing_ms: Mapping[str, float]
) -> bytes:
    """The same as arrays of a NumPy archive, loads stacked along the first axis.

    `voxel_size_m` and `camera_from_grid`; where asked for `observed`, `reconstruction` (bool 64³), `deformed`
    (bool n×64³), `reconstruction_probability` and `probability` (float16), `displacement_m` (float16 n×3×64³);
    or `displacement_at_voxels_m` (float16 3×m, the m voxels set in `deformed` in C order, load after load);
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
        arrays["displacement_m"] = np.stack([half_precision(load) for load in result.loads])
    if "displacement_at_voxels" in outputs:
        moved = [half_precision_at_voxels(load) for load in result.loads]
        arrays["displacement_at_voxels_m"] = np.concatenate(moved, axis=1)
    if "scene" in outputs:
        arrays["scene"] = np.frombuffer(scene_glb(result), np.uint8)
    return npz_bytes(arrays)
