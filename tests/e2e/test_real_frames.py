"""Real frames of real objects through the real service: what a robot would see.

Every object that stands alone in its mask, with and without the mask, the direction of gravity and the contact as a
pixel. What must hold needs no ground truth: the answer covers what the camera saw, stands on the table, is as tall as
the object, moves with the push and stays where it is clamped.
"""

from __future__ import annotations

import base64
import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from typing import Any

import httpx
import numpy as np
import pytest

from service.core.camera import back_project, pixel_to_point, project
from service.core.segmentation import Segment, segment
from tests.conftest import LiveService
from tests.real_frames import SINGLE_OBJECT_HEIGHTS_M, RealFrame, load_frame, needs_frames, object_cases
from tests.service.box_scene import b64, grid, npy, png

pytestmark = needs_frames

MASKED_FRAMES = ("posecnn_000001", "mosd_learn36", "cleargrasp_000000123", "cleargrasp_000000130")

# A body this soft moves visibly under a few newtons whatever its size; the network sees only their ratio.
YOUNG_MODULUS_PA = 5e4
LOAD_NUMBER = 3e-3


@dataclass(frozen=True)
class Push:
    """A point of the visible surface and a direction that presses it in, both in the camera frame."""

    pixel: tuple[float, float]
    point_m: np.ndarray
    direction: np.ndarray


@pytest.fixture(scope="module")
def client(live_service: LiveService) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=live_service.url, timeout=60) as client:
        yield client


@cache
def truth(name: str, label: str) -> Segment:
    """The object as its own mask and plane show it: what an answer is judged by."""
    frame = load_frame(name)
    return segment(frame.depth_m, frame.intrinsics, mask=frame.masks[label])


def push_on(frame: RealFrame, found: Segment) -> Push:
    """Press the pixel nearest to the middle of what is visible, away from the camera and along the table."""
    rows, columns = np.nonzero(found.pixels & np.isfinite(frame.depth_m))
    middle = np.argmin((rows - np.median(rows)) ** 2 + (columns - np.median(columns)) ** 2)
    pixel = (float(columns[middle]), float(rows[middle]))
    point_m = pixel_to_point(*pixel, frame.depth_m, frame.intrinsics, mask=found.pixels)
    direction = point_m / np.linalg.norm(point_m)
    if found.up is not None:
        direction = direction - (direction @ found.up) * found.up
    return Push(pixel, point_m, direction / np.linalg.norm(direction))


def ask(client: httpx.Client, frame: RealFrame, label: str, with_mask: bool, with_up: bool, with_pixel: bool) -> Any:
    found = truth(frame.name, label)
    push = push_on(frame, found)
    camera = frame.intrinsics
    edge_m = 1.4 * float(np.ptp(found.points, axis=0).max())
    force_n = LOAD_NUMBER * YOUNG_MODULUS_PA * edge_m**2 * push.direction
    contact = {"contact_px": push.pixel} if with_pixel else {"contact_m": push.point_m.tolist()}
    depth = {"encoding": "npy", "data": b64(npy(frame.depth_m))}
    if frame.depth_counts.dtype == np.uint16:
        depth = {"encoding": "png16", "unit_m": frame.unit_m, "data": b64(png(frame.depth_counts))}
    body: dict[str, Any] = {
        "camera": {name: getattr(camera, name) for name in ("fx", "fy", "cx", "cy", "width", "height")},
        "depth": depth,
        "material": {"young_modulus_pa": YOUNG_MODULUS_PA, "poisson_ratio": 0.4},
        "loads": [{**contact, "force_n": force_n.tolist()}],
        "outputs": ["reconstruction", "deformed", "displacement"],
    }
    if with_mask:
        body["mask"] = {"encoding": "png8", "data": b64(png(frame.masks[label].astype(np.uint8) * 255))}
    if with_up:
        assert found.up is not None
        body["up"] = found.up.tolist()
    reply = client.post("/v1/deform", content=json.dumps(body), headers={"Content-Type": "application/json"})
    assert reply.status_code == 200, reply.text[:500]
    return reply.json(), push


def check(answer: Any, frame: RealFrame, label: str, push: Push) -> None:
    found = truth(frame.name, label)
    pitch_m = answer["grid"]["voxel_size_m"]
    camera_from_grid = np.array(answer["grid"]["camera_from_grid"])
    rest = grid(answer["reconstruction"])
    deformed = grid(answer["loads"][0]["deformed"])

    # It covers what the camera saw: the points of the object, looked up in the reconstruction.
    local = (found.points - camera_from_grid[:3, 3]) @ camera_from_grid[:3, :3]
    voxels = np.floor(local / pitch_m).astype(int)
    inside = ((voxels >= 0) & (voxels < 64)).all(axis=1)
    observed = np.zeros_like(rest)
    observed[tuple(voxels[inside].T)] = True
    assert inside.mean() >= 0.97, f"{inside.mean():.3f} of the object's points lie in the grid"
    # A surface passes between voxel centres, so a voxel that holds a point of it may lie just outside the body.
    covered = (observed & grown(rest)).sum() / observed.sum()
    assert covered >= 0.97, f"covers {covered:.3f} of the observed surface"

    # It leaves free what the camera saw through.
    centres = (np.argwhere(rest) + 0.5) * pitch_m @ camera_from_grid[:3, :3].T + camera_from_grid[:3, 3]
    pixels, z_m = project(centres.astype(np.float32), frame.intrinsics)
    columns, rows = np.rint(pixels).astype(int).T
    seen = (columns >= 0) & (columns < frame.intrinsics.width) & (rows >= 0) & (rows < frame.intrinsics.height)
    with np.errstate(invalid="ignore"):
        in_front = z_m[seen] < frame.depth_m[rows[seen], columns[seen]] - 3.0 * pitch_m
    assert in_front.mean() < 0.03, f"{in_front.mean():.3f} of the body is where the camera saw through"

    # It stands on the table.
    assert rest[:, :, :2].any(), "nothing touches the support"

    # It is as tall as the object.
    heights = np.flatnonzero(rest.any(axis=(0, 1)))
    height_m = (heights.max() + 1) * pitch_m
    tall_m = expected_height_m(frame, label)
    # A voxel is the best that a grid can tell.
    assert height_m == pytest.approx(tall_m, rel=0.15, abs=pitch_m), f"{1e3 * height_m:.0f} mm for {1e3 * tall_m:.0f}"

    # It moves with the push.
    direction = camera_from_grid[:3, :3].T @ push.direction
    field = answer["loads"][0]["displacement"]
    displacement = displacement_of(field)[:, deformed]
    along = float((direction @ displacement).mean())
    assert along > 0.0, f"moves {1e3 * along:.2f} mm along the push"
    assert answer["loads"][0]["max_displacement_m"] > 0.0

    # It stays where it is clamped.
    bottom = int(heights.min())
    before, after = rest[:, :, bottom], deformed[:, :, bottom]
    stays = (before & after).sum() / (before | after).sum()
    assert stays >= 0.9, f"IoU of the lowest layer {stays:.3f}"


def grown(occupancy: np.ndarray) -> np.ndarray:
    """The body and the 26 neighbours of its voxels."""
    padded = np.pad(occupancy, 1)
    steps = list(np.ndindex(3, 3, 3))
    return np.logical_or.reduce([padded[x : x + 64, y : y + 64, z : z + 64] for x, y, z in steps])


def displacement_of(field: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(field["data"]), "<f2").reshape(field["shape"]).astype(np.float64)


def expected_height_m(frame: RealFrame, label: str) -> float:
    """Measured, where the object is known; else the height of the highest point seen."""
    if frame.name in SINGLE_OBJECT_HEIGHTS_M:
        return SINGLE_OBJECT_HEIGHTS_M[frame.name]
    found = truth(frame.name, label)
    if found.support is None:
        return float(np.ptp(found.points @ found.up))
    points = back_project(frame.depth_m, frame.intrinsics, found.pixels)
    heights_m = points @ found.support.normal.astype(np.float32) + found.support.offset_m
    # The very highest reading is a flying pixel as often as not.
    return float(np.quantile(heights_m, 0.995))


def given(mask: bool, up: bool, pixel: bool) -> Any:
    names = [name for name, is_given in (("mask", mask), ("up", up), ("px", pixel)) if is_given]
    return pytest.param(mask, up, pixel, id="+".join(names) or "bare")


GIVEN = pytest.mark.parametrize(
    ("with_mask", "with_up", "with_pixel"),
    [given(mask, up, pixel) for mask in (False, True) for up in (False, True) for pixel in (False, True)],
)


@GIVEN
@pytest.mark.parametrize("name", SINGLE_OBJECT_HEIGHTS_M)
def test_an_object_alone_on_a_table(client, name, with_mask, with_up, with_pixel):
    frame = load_frame(name)
    (label,) = frame.masks
    answer, push = ask(client, frame, label, with_mask, with_up, with_pixel)
    check(answer, frame, label, push)


@pytest.mark.parametrize(("with_up", "with_pixel"), [(False, False), (True, True)], ids=["mask", "mask+up+px"])
@pytest.mark.parametrize(("name", "label"), object_cases(*MASKED_FRAMES))
def test_one_object_among_others_by_its_mask(client, name, label, with_up, with_pixel):
    frame = load_frame(name)
    answer, push = ask(client, frame, label, True, with_up, with_pixel)
    check(answer, frame, label, push)
