"""Questions and answers as HTTP messages; no socket here."""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import Mapping
from email.utils import parsedate_to_datetime
from typing import Any

import numpy as np
import pybase64

from service.client.displacement import DisplacementField
from service.client.errors import ServiceUnreachable, UnexpectedReply, problem_error
from service.client.question import Camera, Earlier, Image, Push, Question, Shape, triple
from service.client.result import PushResult, Result
from service.core.arrays import GRID_SIZE, Occupancy, Probability
from service.core.errors import PhysNetError
from service.core.grids import Grid, unpack_bits

_BROKEN_GATEWAY = (502, 503, 504)
"""Of a proxy whose service is away; ours says more than a bare status."""


# --- questions --------------------------------------------------------------------------------------------------


def body(question: Question, small: bool = True) -> dict[str, Any]:
    """The request as JSON, images apart; `small` asks for displacements at voxels alone."""
    document: dict[str, Any] = {
        "material": _material(question.material),
        "loads": [_push(push) for push in question.pushes],
        "outputs": list(question.outputs),
        "uncertainty_samples": question.uncertainty_samples,
    }
    if small and at_voxels(question):
        document["displacement_form"] = "voxels"
    if question.camera is not None:
        document["camera"] = _camera(question.camera)
    match question.source:
        case Shape():
            document["shape"] = _shape(question.source)
        case Earlier():
            document["reconstruction_id"] = question.source.reconstruction_id
        case Image():
            document["depth"] = _image(question.source)
    if question.mask is not None:
        document["mask"] = {"encoding": question.mask.encoding}
    for name in ("up", "roi", "threshold"):
        if (value := getattr(question, name)) is not None:
            document[name] = value
    return document


def files(question: Question) -> dict[str, bytes]:
    """The images, as the file parts of a multipart request."""
    parts = {"depth": question.source.data} if isinstance(question.source, Image) else {}
    return parts if question.mask is None else parts | {"mask": question.mask.data}


def at_voxels(question: Question) -> bool:
    """Whether displacements can travel at the voxels of the deformed body alone, which says where they are."""
    return "displacement" in question.outputs and "deformed" in question.outputs


def knows_only_grids(refused: PhysNetError) -> bool:
    """Whether a service refused because it is older than displacements at voxels."""
    return refused.field == "displacement_form"


def encode(question: Question, small: bool = True) -> tuple[dict[str, str], bytes]:
    """Headers and content of the request: a form with the images as they are, JSON where there are none."""
    document = json.dumps(body(question, small)).encode()
    images = files(question)
    if not images:
        return {"Content-Type": "application/json"}, document
    # 128 random bits: no image holds them.
    boundary = secrets.token_hex(16)
    content = bytearray()
    for name, data in {"request": document, **images}.items():
        # A part with a file name is a file.
        is_file, kind = (f'; filename="{name}"', "octet-stream") if name in images else ("", "json")
        content += f'--{boundary}\r\nContent-Disposition: form-data; name="{name}"{is_file}\r\n'.encode()
        content += f"Content-Type: application/{kind}\r\n\r\n".encode() + data + b"\r\n"
    content += f"--{boundary}--\r\n".encode()
    return {"Content-Type": f"multipart/form-data; boundary={boundary}"}, bytes(content)


def _camera(camera: Camera) -> dict[str, Any]:
    numbers = {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")}
    return {**numbers, "distortion": list(camera.distortion) or None}


def _image(image: Image) -> dict[str, Any]:
    return {"encoding": image.encoding, "unit_m": image.unit_m}


def _shape(shape: Shape) -> dict[str, Any]:
    return {
        "encoding": "bits",
        "data": pybase64.b64encode_as_string(shape.bits),
        "voxel_size_m": float(shape.voxel_size_m),
        "camera_from_grid": np.asarray(shape.camera_from_grid, np.float64).tolist(),
    }


def _material(material: str | tuple[float | int, float | int]) -> dict[str, Any]:
    if isinstance(material, str):
        return {"name": material}
    return dict(zip(("young_modulus_pa", "poisson_ratio"), (float(number) for number in material), strict=True))


def _push(push: Push) -> dict[str, Any]:
    document: dict[str, Any] = {"force_n": triple(push.force_n)}
    if push.contact_m is not None:
        document["contact_m"] = triple(push.contact_m)
    if push.contact_px is not None:
        document["contact_px"] = [float(number) for number in push.contact_px]
    if push.patch_radius_m is not None:
        document["patch_radius_m"] = float(push.patch_radius_m)
    return document


# --- answers ----------------------------------------------------------------------------------------------------


def decode(status: int, headers: Mapping[str, str], content: bytes) -> Any:
    """The JSON document of a reply.

    Raises:
        PhysNetError: What the service said was wrong, typed; or the reply is none of ours.
    """
    try:
        document = json.loads(content)
    except ValueError:
        document = None
    if status < 300 and document is not None:
        return document
    raise _refusal(status, headers, document if isinstance(document, dict) else {})


def _refusal(status: int, headers: Mapping[str, str], document: Mapping[str, Any]) -> PhysNetError:
    if "code" in document:
        return problem_error(document, _retry_after_s(headers))
    if status in _BROKEN_GATEWAY:
        return ServiceUnreachable(f"The service is away: a gateway answered with status {status}.", actual=status)
    return UnexpectedReply(f"No PhysNet service answered: status {status} without a problem document.", actual=status)


def _retry_after_s(headers: Mapping[str, str]) -> float | None:
    """Seconds, from a number of them or, as proxies may write it, a date."""
    given = headers.get("retry-after", "")
    try:
        return max(0.0, float(given))
    except ValueError:
        pass
    try:
        return max(0.0, parsedate_to_datetime(given).timestamp() - time.time())
    except ValueError:
        return None


def result(document: Mapping[str, Any]) -> Result:
    """A reply's document as a result.

    Raises:
        UnexpectedReply: It is no reply of `POST /v1/deform`.
    """
    try:
        grid = Grid(
            float(document["grid"]["voxel_size_m"]), np.array(document["grid"]["camera_from_grid"], np.float64)
        )
        return Result(
            request_id=document["request_id"],
            model=(document["model"]["name"], document["model"]["version"]),
            grid=grid,
            seen=_bits(document, "observed"),
            body=_bits(document, "reconstruction"),
            body_probability=_levels(document, "reconstruction_probability"),
            pushes=tuple(_push_result(load, grid) for load in document["loads"]),
            flags=frozenset(document["flags"]),
            timing_ms=dict(document["timing_ms"]),
            reconstruction_id=document.get("reconstruction_id"),
        )
    except (KeyError, TypeError, ValueError) as error:
        raise UnexpectedReply(f"The reply is not that of a PhysNet service: {error!r}") from error


def _push_result(load: Mapping[str, Any], grid: Grid) -> PushResult:
    deformed = _bits(load, "deformed")
    travelled = load.get("displacement_at_voxels", load.get("displacement"))
    return PushResult(
        grid=grid,
        occupancy=deformed,
        probability=_levels(load, "probability"),
        displacement=travelled and displacement_from(_decoded(travelled), deformed),
        max_displacement_m=load["max_displacement_m"],
        mean_displacement_m=load["mean_displacement_m"],
        load_number=load["load_number"],
        flags=frozenset(load["flags"]),
    )


def _bits(document: Mapping[str, Any], name: str) -> Occupancy | None:
    return occupancy_from(_decoded(document[name])) if name in document else None


def _levels(document: Mapping[str, Any], name: str) -> Probability | None:
    return probability_from(_decoded(document[name])) if name in document else None


def _decoded(part: Mapping[str, Any]) -> bytes:
    return pybase64.b64decode(part["data"], validate=True)


def occupancy_from(data: bytes) -> Occupancy:
    """Voxels from the bits that travel."""
    return unpack_bits(np.frombuffer(data, np.uint8))


def probability_from(data: bytes) -> Probability:
    """Probabilities from the levels that travel, value/255."""
    return np.frombuffer(data, np.uint8).reshape((GRID_SIZE,) * 3) / np.float32(255.0)


def displacement_from(data: bytes, deformed: Occupancy | None) -> DisplacementField:
    """The field from the half-precision metres that travel, in either form; a view of them.

    Raises:
        UnexpectedReply: They are not those of the deformed body.
    """
    travelled_m = np.frombuffer(data, "<f2")
    on_grid = travelled_m.size == 3 * GRID_SIZE**3
    try:
        return DisplacementField(travelled_m.reshape((3, *(GRID_SIZE,) * 3) if on_grid else (3, -1)), deformed)
    except ValueError as error:
        raise UnexpectedReply(f"The reply is not that of a PhysNet service: {error}") from error
