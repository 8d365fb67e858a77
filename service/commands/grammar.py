"""What the options of `physnet predict` mean: from text to the question that a robot would ask."""

from __future__ import annotations

import argparse
import json
import struct
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from service.commands.exits import UsageError

if TYPE_CHECKING:
    from service.client.question import Camera, Image, Push, Question


def question_of(given: argparse.Namespace) -> Question:
    """The question that the command line asks.

    Raises:
        UsageError: An option or file cannot be used. Whether its numbers make sense is for the predictor to judge.
        OSError: A file cannot be read.
    """
    from service.client.question import OUTPUTS, Image, Question, depth_image

    known = _document(given.intrinsics)
    unit_m = given.unit_m if given.unit_m is not None else known.get("depth_unit_m")
    try:
        depth = depth_image(given.depth, unit_m)
        camera = _camera(given.intrinsics, known, depth)
    except (KeyError, ValueError, TypeError) as error:
        reason = f"{error.args[0]} is missing" if isinstance(error, KeyError) else str(error)
        option = "--intrinsics" if isinstance(error, KeyError) else "depth"
        raise UsageError(f"{option}: {reason}") from None
    return Question(
        source=depth,
        camera=camera,
        pushes=(push_of(given, camera),),
        material=material_of(given.material),
        mask=Image("png8", given.mask.read_bytes()) if given.mask else None,
        up=_three("--up", given.up) if given.up else None,
        outputs=OUTPUTS,
    )


def numbers(option: str, text: str, counts: tuple[int, ...]) -> list[float]:
    """Numbers separated by commas.

    Raises:
        UsageError: Something else, or not as many as `counts` allows.
    """
    try:
        found = [float(part) for part in text.split(",")]
    except ValueError:
        found = []
    if len(found) not in counts:
        raise UsageError(f"{option}: {text!r} must be {' or '.join(map(str, counts))} numbers separated by commas")
    return found


def image_size(image: Image) -> tuple[int, int]:
    """Width and height that a PNG or `.npy` file tells of itself.

    Raises:
        ValueError: It does not.
    """
    if image.encoding == "png16" and len(image.data) >= 24:
        width, height = struct.unpack_from(">II", image.data, 16)
        return width, height
    import io

    stream = io.BytesIO(image.data)
    version = np.lib.format.read_magic(stream)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, _ = read(stream)
    if len(shape) not in (2, 3):
        raise ValueError(f"the depth file holds {len(shape)} dimensions, not an image")
    return int(shape[1]), int(shape[0])


def _document(intrinsics: str) -> dict[str, Any]:
    """The calibration: numbers from the command line, or what the file holds."""
    if "," in intrinsics and not Path(intrinsics).exists():
        return dict(zip(("fx", "fy", "cx", "cy"), numbers("--intrinsics", intrinsics, (4,)), strict=True))
    try:
        return dict(json.loads(Path(intrinsics).read_text("utf-8")))
    except (ValueError, TypeError) as error:
        raise UsageError(f"--intrinsics: {intrinsics} is not a JSON object: {error}") from None


def _camera(intrinsics: str, known: dict[str, Any], depth: Image) -> Camera:
    from service.client.question import Camera

    missing = [name for name in ("fx", "fy", "cx", "cy") if not isinstance(known.get(name), int | float)]
    if missing:
        raise UsageError(f"--intrinsics: {intrinsics} lacks {', '.join(missing)}")
    if "width" not in known or "height" not in known:
        known["width"], known["height"] = image_size(depth)
    return Camera.from_json(known)


def material_of(text: str) -> str | tuple[float, float]:
    """`--material`: a name, or Young's modulus in Pa and Poisson's ratio."""
    if "," not in text:
        return text
    e_pa, nu = numbers("--material", text, (2,))
    return e_pa, nu


def _three(option: str, text: str) -> tuple[float, float, float]:
    x, y, z = numbers(option, text, (3,))
    return x, y, z


def push_of(given: argparse.Namespace, camera: Camera) -> Push:
    """`--press`, `--force`, `--direction` and `--patch-radius-m` on a camera's image."""
    from service.client.question import Push

    press = numbers("--press", given.press, (2, 3))
    force = numbers("--force", given.force, (1, 3))
    if len(force) == 1:
        force = [force[0] * component for component in _direction(given.direction, press, camera)]
    elif given.direction:
        raise UsageError("--direction: give --force as one number, or as a vector and no direction")
    contact = {"contact_px": press} if len(press) == 2 else {"contact_m": press}
    return Push(force_n=force, patch_radius_m=given.patch_radius_m, **contact)


def _direction(text: str | None, press: list[float], camera: Camera) -> list[float]:
    """Unit vector of the force: as given, or from the camera to the contact, as a robot pokes at what it sees."""
    if text:
        ray, option = np.array(_three("--direction", text)), "--direction"
    elif len(press) == 3:
        ray, option = np.array(press), "--press"
    elif camera.fx == 0.0 or camera.fy == 0.0:
        raise UsageError("--intrinsics: no viewing ray without fx and fy")
    else:
        ray = np.array([(press[0] - camera.cx) / camera.fx, (press[1] - camera.cy) / camera.fy, 1.0])
        option = "--press"
    length = float(np.linalg.norm(ray))
    if not 0.0 < length < np.inf:
        raise UsageError(f"{option}: no direction in a vector of length {length:g}; give --force as a vector")
    return [float(component) for component in ray / length]
