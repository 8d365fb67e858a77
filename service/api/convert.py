"""From the wire to `service.core.messages`. The only place where requests are translated; replies: `replies`."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from pydantic import ValidationError

from service.api.problem import validation_failed
from service.api.schemas import DeformBody, LoadBody, MaterialBody, ShapeBody
from service.core.arrays import Vector3
from service.core.camera import make_intrinsics, parse_up
from service.core.errors import InvalidFrame, InvalidRequest
from service.core.materials import Material, material, material_named
from service.core.messages import (
    DeformRequest,
    EarlierReconstruction,
    EncodedImage,
    KnownShape,
    Load,
    Observation,
)

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_NPY_SIGNATURE = b"\x93NUMPY"


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
        outputs=_outputs(body),
        threshold=body.threshold,
        uncertainty_samples=body.uncertainty_samples,
    )


def _outputs(body: DeformBody) -> frozenset[str]:
    outputs = frozenset(body.outputs)
    if body.displacement_form == "grid" or "displacement" not in outputs:
        return outputs
    if "deformed" not in outputs:
        raise InvalidRequest(
            "Displacements at voxels are those of the deformed body, which says where they are.",
            field="displacement_form", expected="`deformed` among the outputs",
        )  # fmt: skip
    return outputs - {"displacement"} | {"displacement_at_voxels"}


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
