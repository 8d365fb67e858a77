"""Which push moves this object's top most, without bending it further than allowed? One request asks all of them.

    python examples/client_plan.py [--url grpc://127.0.0.1:8001] [--force 5] [--limit-mm 40]

Twelve horizontal directions are tried at the contact; one reconstruction and one batch of the deformation network
answer them together. With a body kept by the service, further pushes need no frame any more.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import cv2
import numpy as np

from service.client import Camera, PhysNetClient, PhysNetError, Push

FRAME = Path(__file__).resolve().parent / "frames" / "sugar_box"
CONTACT_PX = (385, 125)
DIRECTIONS = 12


def horizontal_pushes(up: np.ndarray, force_n: float) -> list[Push]:
    """Pushes of one force all around the vertical, camera frame."""
    across = np.cross(up, np.eye(3)[np.abs(up).argmin()])
    across /= np.linalg.norm(across)
    along = np.cross(up, across)
    angles = 2.0 * np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    return [
        Push(force_n * (np.cos(angle) * across + np.sin(angle) * along), contact_px=CONTACT_PX) for angle in angles
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description="Choose among pushes by what they would do.")
    parser.add_argument("--url", default="grpc://127.0.0.1:8001")
    parser.add_argument("--force", type=float, default=5.0, metavar="N")
    parser.add_argument("--limit-mm", type=float, default=40.0, metavar="MM", help="largest displacement allowed")
    given = parser.parse_args()
    depth_mm = cv2.imread(str(FRAME / "depth.png"), cv2.IMREAD_UNCHANGED)
    assert depth_mm is not None
    camera = Camera.from_json(FRAME / "intrinsics.json")
    with PhysNetClient(given.url) as client:
        try:
            # A first, small question tells the upright direction: the grid's z axis.
            first = client.deform(depth_mm, camera, Push((0.0, 0.0, 1.0), contact_px=CONTACT_PX), "dragon_skin_10")
            pushes = horizontal_pushes(first.grid.camera_from_grid[:3, 2], given.force)
            result = client.deform(depth_mm, camera, pushes, "dragon_skin_10")
        except PhysNetError as error:
            raise SystemExit(f"{error.code}: {error.message}") from None
    moved_mm = [1e3 * answer.max_displacement_m for answer in result]
    for number, (push, millimetres) in enumerate(zip(pushes, moved_mm, strict=True)):
        force = ", ".join(f"{component:6.1f}" for component in np.asarray(push.force_n))
        print(f"{360 * number // DIRECTIONS:4d}°  force ({force}) N  moves {millimetres:5.1f} mm")
    allowed = [number for number, millimetres in enumerate(moved_mm) if millimetres <= given.limit_mm]
    if not allowed:
        raise SystemExit(f"every push moves more than {given.limit_mm:g} mm")
    best = max(allowed, key=lambda number: moved_mm[number])
    took_ms = result.timing_ms["total"]
    print(f"chosen: {360 * best // DIRECTIONS}°, {moved_mm[best]:.1f} mm; {DIRECTIONS} pushes in {took_ms:.0f} ms")


if __name__ == "__main__":
    main()
