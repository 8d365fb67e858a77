"""What is asked, in every form in which a wire takes it."""

from __future__ import annotations

import base64
import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from service.api.generated import deformation_pb2 as pb

SAMPLE = Path(__file__).resolve().parent / "sample"
"""A mug on a table, 640×480, 16-bit PNG, from the sample frames of 6-DOF GraspNet."""

BOUNDARY = "physnet-bench-boundary"
DEPTH_ENCODINGS: Mapping[str, pb.DepthEncoding] = {"png16": pb.DEPTH_ENCODING_PNG16, "npy": pb.DEPTH_ENCODING_NPY}
_CAMERA = ("fx", "fy", "cx", "cy", "width", "height")


@dataclass(frozen=True)
class BenchQuestion:
    """One depth frame and pushes on it.

    Attributes:
        depth: The file's bytes.
        encoding: `png16` or `npy`.
        camera: Intrinsics by name.
        contact_px: Where the first load pushes.
        force_n: The first load's force, camera frame.
        loads: How many; each further one pushes at the same place in another direction.
        material: By name.
        outputs: What is asked for.
        unit_m: Metres per count; None for the encoding's own.
    """

    depth: bytes
    encoding: str
    camera: dict[str, float]
    contact_px: tuple[float, float]
    force_n: tuple[float, float, float]
    loads: int = 1
    material: str = "dragon_skin_10"
    outputs: tuple[str, ...] = ("reconstruction", "deformed")
    unit_m: float | None = None

    @cached_property
    def forces_n(self) -> list[list[float]]:
        """The first load's force, turned about the optical axis."""
        x, y, z = self.force_n
        angles = 2.0 * np.pi * np.arange(self.loads) / self.loads
        return [[float(np.cos(a) * x - np.sin(a) * y), float(np.sin(a) * x + np.cos(a) * y), z] for a in angles]

    def body(self, *, with_data: bool) -> dict[str, Any]:
        """The request as a JSON document, with the frame in it or as a file beside it."""
        depth: dict[str, Any] = {"encoding": self.encoding, "unit_m": self.unit_m}
        if with_data:
            depth["data"] = base64.b64encode(self.depth).decode("ascii")
        return {
            "camera": self.camera,
            "depth": depth,
            "material": {"name": self.material},
            "loads": [{"contact_px": self.contact_px, "force_n": force_n} for force_n in self.forces_n],
            "outputs": self.outputs,
        }

    @cached_property
    def json(self) -> bytes:
        """Body of an `application/json` request."""
        return json.dumps(self.body(with_data=True)).encode()

    @cached_property
    def multipart(self) -> bytes:
        """Body of a `multipart/form-data` request with `BOUNDARY`."""
        parts = (
            (b'name="request"', b"application/json", json.dumps(self.body(with_data=False)).encode()),
            (b'name="depth"; filename="depth"', b"application/octet-stream", self.depth),
        )
        lines = b"".join(
            b"--%b\r\nContent-Disposition: form-data; %b\r\nContent-Type: %b\r\n\r\n%b\r\n"
            % (BOUNDARY.encode(), name, kind, data)
            for name, kind, data in parts
        )
        return lines + b"--%b--\r\n" % BOUNDARY.encode()

    @cached_property
    def message(self) -> pb.DeformRequest:
        """The same for gRPC."""
        camera = self.camera
        u, v = self.contact_px
        return pb.DeformRequest(
            camera=pb.Camera(
                fx=camera["fx"], fy=camera["fy"], cx=camera["cx"], cy=camera["cy"],
                width=int(camera["width"]), height=int(camera["height"]),
            ),
            depth=pb.DepthImage(encoding=DEPTH_ENCODINGS[self.encoding], data=self.depth, unit_m=self.unit_m),
            material=pb.Material(name=self.material),
            loads=[
                pb.Load(force_n=pb.Vector3(x=x, y=y, z=z), contact_px=pb.Pixel(u=u, v=v)) for x, y, z in self.forces_n
            ],
            outputs=pb.Outputs(**dict.fromkeys(self.outputs, True)),
        )  # fmt: skip


def sample_question(loads: int = 1) -> BenchQuestion:
    """A push on the bundled frame."""
    return BenchQuestion(
        depth=(SAMPLE / "depth.png").read_bytes(),
        encoding="png16",
        camera=read_camera(SAMPLE / "intrinsics.json"),
        contact_px=(365.0, 215.0),
        force_n=(0.0, 6.0, 24.0),
        loads=loads,
    )


def read_camera(path: Path) -> dict[str, float]:
    """Intrinsics of a JSON file with fx, fy, cx, cy, width, height.

    Raises:
        ValueError: It is no such file.
    """
    try:
        known = json.loads(path.read_text("utf-8"))
        return {name: known[name] for name in _CAMERA}
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is no JSON object with {', '.join(_CAMERA)}: {error}") from None
