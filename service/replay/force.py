"""Where a push attacks and how, in metres: to be drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from service.client.question import Camera, Image, Push
from service.core.arrays import Vector3
from service.core.camera import make_intrinsics, pixel_to_point
from service.core.depth import decode_depth
from service.core.errors import PhysNetError


@dataclass(frozen=True)
class Force:
    """Camera frame; metres and newtons."""

    contact_m: Vector3
    force_n: Vector3


def force_of(push: Push, depth: Image, camera: Camera) -> Force | None:
    """A push with its contact in metres; None where its pixel has no reading."""
    force_n = np.asarray(push.force_n, np.float64)
    if push.contact_m is not None:
        return Force(np.asarray(push.contact_m, np.float64), force_n)
    if push.contact_px is None:
        return None
    try:
        intrinsics = make_intrinsics(
            camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, list(camera.distortion) or None
        )
        depth_m = decode_depth(depth.encoding, depth.data, depth.unit_m, camera.width, camera.height)
        u, v = (float(number) for number in push.contact_px)
        return Force(pixel_to_point(u, v, depth_m, intrinsics), force_n)
    except PhysNetError:
        return None
