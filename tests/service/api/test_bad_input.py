"""Every bad input that a robot can send, over the real socket to the real service: its own named error or flag."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import cv2
import httpx
import numpy as np
import pytest

from tests.conftest import LiveService
from tests.service.box_scene import BoxScene, b64, box_shape, grid, npy, png

SCENE = BoxScene()
NAN = float("nan")


@pytest.fixture(scope="module")
def client(live_service: LiveService) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=live_service.url, timeout=30) as client:
        yield client


@pytest.fixture(scope="module")
def usual_answer(client: httpx.Client) -> dict[str, Any]:
    return answered(client, SCENE.request())


def post(client: httpx.Client, body: dict[str, Any]) -> httpx.Response:
    # Python's own JSON writes NaN, as many robots' do; httpx would refuse to send it.
    return client.post("/v1/deform", content=json.dumps(body), headers={"Content-Type": "application/json"})


def answered(client: httpx.Client, body: dict[str, Any]) -> dict[str, Any]:
    reply = post(client, body)
    assert reply.status_code == 200, reply.text
    return reply.json()


def refused(client: httpx.Client, body: dict[str, Any], code: str, field: str | None) -> dict[str, Any]:
    reply = post(client, body)
    assert reply.headers["content-type"] == "application/problem+json", reply.text[:300]
    document = reply.json()
    assert (document["code"], document.get("field")) == (code, field), document
    assert document["status"] == reply.status_code
    assert 400 <= reply.status_code < 500
    assert document["detail"]
    assert "Traceback" not in reply.text
    assert "/service/" not in reply.text
    return document


def flags(answer: dict[str, Any]) -> set[str]:
    return set(answer["flags"]) | set(answer["loads"][0]["flags"])


def depth(data: bytes, encoding: str = "png16") -> dict[str, Any]:
    return {"encoding": encoding, "data": b64(data)}


def material(young_modulus_pa: float, poisson_ratio: float) -> dict[str, float]:
    return {"young_modulus_pa": young_modulus_pa, "poisson_ratio": poisson_ratio}


def mask(image: np.ndarray) -> dict[str, Any]:
    return {"encoding": "png8", "data": b64(png(image))}


COUNTS = SCENE.counts()
GREY = (COUNTS // 8).astype(np.uint8)
COLOUR = np.dstack([COUNTS] * 3)
PNG = SCENE.depth_png()


@pytest.mark.parametrize(
    ("data", "encoding"),
    [
        pytest.param(PNG[: len(PNG) // 2], "png16", id="truncated-png"),
        pytest.param(PNG[:20], "png16", id="png-cut-in-its-header"),
        pytest.param(PNG[:-40] + bytes(40), "png16", id="png-with-a-damaged-end"),
        pytest.param(png(GREY), "png16", id="8-bit-png"),
        pytest.param(png(COLOUR), "png16", id="colour-png"),
        pytest.param(cv2.imencode(".jpg", GREY)[1].tobytes(), "png16", id="jpeg"),
        pytest.param(b"", "png16", id="no-bytes"),
        pytest.param(b"\x00" * 100, "png16", id="zeros"),
        pytest.param(COUNTS.tobytes()[:-2], "16UC1", id="raw-too-short"),
        pytest.param(COUNTS.tobytes(), "32FC1", id="raw-of-another-type"),
        pytest.param(npy(COUNTS)[:-100], "npy", id="truncated-npy"),
        pytest.param(npy(COUNTS.astype(np.int64)), "npy", id="npy-of-64-bit-integers"),
        pytest.param(npy(COUNTS[None, None]), "npy", id="npy-of-four-dimensions"),
        pytest.param(b"\x00" * 12, "compressedDepth", id="compressedDepth-without-image"),
    ],
)
def test_a_depth_image_that_does_not_decode(client, data, encoding):
    refused(client, SCENE.request(depth=depth(data, encoding)), "invalid_frame", "depth")


def test_an_unknown_encoding_lists_the_known(client):
    document = refused(client, SCENE.request(depth=depth(PNG, "jpeg")), "invalid_frame", "depth.encoding")
    assert "png16" in document["expected"]


@pytest.mark.parametrize("unit_m", [0.0, -0.001, NAN])
def test_a_unit_that_is_no_length(client, unit_m):
    refused(client, SCENE.request(depth=depth(PNG) | {"unit_m": unit_m}), "invalid_frame", "depth.unit_m")


def test_a_size_that_is_not_the_cameras(client):
    camera = SCENE.camera | {"width": 640, "height": 480}
    document = refused(client, SCENE.request(camera=camera), "invalid_frame", "depth")
    assert (document["expected"], document["actual"]) == ("640x480", "320x240")


@pytest.mark.parametrize(
    "image",
    [
        pytest.param(depth(png(COUNTS * 0)), id="zeros"),
        pytest.param(depth(npy(np.full(COUNTS.shape, np.nan, np.float32)), "npy"), id="nan"),
        pytest.param(depth(np.full(COUNTS.shape, np.inf, "<f4").tobytes(), "32FC1"), id="inf"),
    ],
)
def test_a_frame_without_any_reading(client, image):
    refused(client, SCENE.request(depth=image), "invalid_frame", "depth")


def test_an_image_beyond_the_limit_is_refused_from_its_header(client):
    # 40 gigapixels in 60 bytes: decoding it would take the machine down.
    header = png(np.zeros((1, 1), np.uint16))
    side = (200_000).to_bytes(4, "big")
    huge = header[:16] + side + side + header[24:]
    camera = SCENE.camera | {"width": 200_000, "height": 200_000}
    reply = post(client, SCENE.request(depth=depth(huge), camera=camera))
    assert reply.json()["code"] in ("payload_too_large", "invalid_frame")
    assert reply.elapsed.total_seconds() < 5.0


@pytest.mark.parametrize("name", ["fx", "fy"])
@pytest.mark.parametrize("value", [0.0, -600.0, NAN, float("inf")])
def test_a_focal_length_that_is_none(client, name, value):
    refused(client, SCENE.request(camera=SCENE.camera | {name: value}), "invalid_camera", f"camera.{name}")


@pytest.mark.parametrize("name", ["cx", "cy"])
def test_a_principal_point_that_is_nan(client, name):
    refused(client, SCENE.request(camera=SCENE.camera | {name: NAN}), "invalid_camera", f"camera.{name}")


@pytest.mark.parametrize("distortion", [[0.1], [0.1, NAN, 0.0, 0.0], [0.0] * 15])
def test_a_distortion_that_is_none(client, distortion):
    document = post(client, SCENE.request(camera=SCENE.camera | {"distortion": distortion})).json()
    assert document["code"] == "invalid_camera"
    assert document["field"].startswith("camera.distortion")


def test_a_mask_without_a_pixel(client):
    refused(client, SCENE.request(mask=mask(np.zeros(COUNTS.shape, np.uint8))), "empty_object", "mask")


def test_a_mask_where_the_camera_saw_nothing(client):
    counts = COUNTS.copy()
    shown = SCENE.render()[1]
    counts[shown] = 0
    refused(client, SCENE.request(depth=depth(png(counts)), mask=mask(shown.astype(np.uint8))), "empty_object", "mask")


@pytest.mark.parametrize(
    "data",
    [
        pytest.param(png(np.ones((10, 10), np.uint8)), id="of-another-size"),
        pytest.param(png(COLOUR.astype(np.uint8)), id="in-colour"),
        pytest.param(SCENE.mask_png()[:-30], id="truncated"),
        pytest.param(b"mask", id="not-a-png"),
    ],
)
def test_a_mask_that_does_not_decode(client, data):
    refused(client, SCENE.request(mask={"data": b64(data)}), "invalid_frame", "mask")


@pytest.mark.parametrize("up", [[0.0, 0.0, 0.0], [NAN, -1.0, 0.0], [float("inf"), 0.0, 0.0]])
def test_an_up_without_direction(client, up):
    refused(client, SCENE.request(up=up), "invalid_camera", "up")


def ball_alone() -> dict[str, Any]:
    """A ball of 6 cm radius, 0.6 m in front of the camera, and nothing else."""
    camera = SCENE.camera
    v, u = np.indices(COUNTS.shape)
    rays = np.dstack([(u - camera["cx"]) / camera["fx"], (v - camera["cy"]) / camera["fy"], np.ones(COUNTS.shape)])
    centre, radius = np.array([0.0, 0.0, 0.6]), 0.06
    a, b, c = (rays**2).sum(-1), rays @ centre, centre @ centre - radius**2
    root = b**2 - a * c
    depth_m = np.where(root > 0, (b - np.sqrt(np.maximum(root, 0))) / a, 0.0)
    load = {"contact_m": [0.0, 0.0, 0.54], "force_n": [0.0, 0.0, 2.0]}
    return SCENE.request(depth=depth(png(np.rint(depth_m * 1000).astype(np.uint16))), loads=[load])


@pytest.mark.parametrize(
    "body",
    [
        pytest.param(ball_alone(), id="a-ball"),
        # Two faces of a box are two planes, but nothing stands on either.
        pytest.param(replace(SCENE, table_half_m=0.0, elevation_rad=0.6).request(), id="a-box"),
    ],
)
def test_no_plane_in_sight_and_no_up(client, body):
    document = refused(client, body, "no_support_plane", "up")
    assert "`up`" in document["detail"]


def test_no_plane_in_sight_but_up(client):
    alone = replace(SCENE, table_half_m=0.0, elevation_rad=0.3)
    answer = answered(client, alone.request(up=alone.up))
    assert "support_not_seen" in flags(answer)
    assert grid(answer["reconstruction"]).any()


def test_an_object_cut_by_the_image_border_is_answered_with_a_flag(client):
    cut = replace(SCENE, aim_offset_m=(-0.30, 0.0, 0.0))
    shown = cut.render()[1]
    assert shown[:, -1].any() and shown.sum() > 500
    load = {"contact_px": [cut.width - 6, 110], "force_n": [0.0, 0.0, 1.0]}
    assert "object_cut_by_border" in flags(answered(client, cut.request(loads=[load])))
    assert "object_cut_by_border" not in flags(answered(client, SCENE.request()))


def test_a_table_without_an_object(client):
    empty = replace(SCENE, size_m=(0.0, 0.0, 0.0))
    load = {"contact_px": [160, 120], "force_n": [0.0, 0.0, 1.0]}
    assert post(client, empty.request(loads=[load])).json()["code"] == "empty_object"


def test_a_contact_far_off_the_body_is_told_its_distance(client):
    off = SCENE.in_camera((0.0, 0.0, SCENE.size_m[2] + 0.30))
    good = SCENE.request()["loads"][0]
    body = SCENE.request(loads=[good, good | {"contact_m": off}])
    document = refused(client, body, "contact_off_body", "loads[1].contact_m")
    assert document["actual"] == pytest.approx(0.30, abs=0.02)
    assert document["expected"] < 0.1


@pytest.mark.parametrize("pixel", [[-1.0, 10.0], [320.0, 10.0], [10.0, 1e9]])
def test_a_contact_pixel_outside_the_image(client, pixel):
    load = {"contact_px": pixel, "force_n": [0.0, 0.0, 1.0]}
    refused(client, SCENE.request(loads=[load]), "invalid_request", "loads[0].contact_px")


def test_a_contact_pixel_without_a_reading(client):
    counts = COUNTS.copy()
    counts[:60, :60] = 0
    load = {"contact_px": [10, 10], "force_n": [0.0, 0.0, 1.0]}
    refused(client, SCENE.request(depth=depth(png(counts)), loads=[load]), "invalid_request", "loads[0].contact_px")


def test_a_contact_slightly_off_the_surface_is_moved_with_a_flag(client):
    off = SCENE.in_camera((0.0, 0.0, SCENE.size_m[2] + 0.015))
    load = {"contact_m": off, "force_n": SCENE.direction((0.0, 0.0, -2.0))}
    assert "contact_snapped" in flags(answered(client, SCENE.request(loads=[load])))


def test_a_zero_force_is_answered_nothing_moves(client):
    load = SCENE.request()["loads"][0] | {"force_n": [0.0, 0.0, 0.0]}
    answer = answered(client, SCENE.request(loads=[load]))
    moved = answer["loads"][0]
    assert moved["max_displacement_m"] == moved["mean_displacement_m"] == moved["load_number"] == 0.0
    np.testing.assert_array_equal(grid(moved["deformed"]), grid(answer["reconstruction"]))


def test_a_force_far_beyond_training_is_answered_with_a_flag(client):
    load = SCENE.request()["loads"][0] | {"force_n": SCENE.direction((0.0, 1e6, 0.0))}
    answer = answered(client, SCENE.request(loads=[load]))
    assert "outside_training_range" in flags(answer)
    assert np.isfinite(answer["loads"][0]["max_displacement_m"])


@pytest.mark.parametrize("young_modulus_pa", [0.0, -1e5, NAN, float("inf")])
def test_a_stiffness_that_is_none(client, young_modulus_pa):
    body = SCENE.request(material=material(young_modulus_pa, 0.3))
    refused(client, body, "material_out_of_range", "material.young_modulus_pa")


@pytest.mark.parametrize("poisson_ratio", [-0.01, 0.501, NAN])
def test_a_poisson_ratio_out_of_its_range(client, poisson_ratio):
    body = SCENE.request(material=material(1e5, poisson_ratio))
    refused(client, body, "material_out_of_range", "material.poisson_ratio")


def test_an_incompressible_body_is_answered_with_a_flag(client):
    assert "poisson_ratio_clamped" in flags(answered(client, SCENE.request(material=material(1e5, 0.5))))
    assert "poisson_ratio_clamped" not in flags(answered(client, SCENE.request(material=material(1e5, 0.49))))


def test_an_unknown_material_lists_the_nearest(client):
    document = refused(client, SCENE.request(material={"name": "silicon"}), "unknown_material", "material.name")
    assert document["expected"][0] == "silicone"
    assert len(document["expected"]) == 5


@pytest.mark.parametrize("roi", [[0, 0, 0, 10], [400, 0, 10, 10], [-20, 0, 10, 10], [0, 0, -3, 4]])
def test_a_region_of_interest_that_is_none(client, roi):
    reply = post(client, SCENE.request(roi=roi))
    document = reply.json()
    assert reply.status_code == 400, document
    assert (document["code"], document["field"]) == ("invalid_request", "roi")


SHAPE = {"depth": ..., "camera": ...}


def shape_load() -> dict[str, Any]:
    # The block of `box_shape` stands 0.5 to 0.6 m in front of the camera; this is the middle of its near side.
    return {"contact_m": [0.0, 0.05, 0.55], "force_n": [0.0, 0.0, 2.0]}


def test_a_known_shape_is_answered(client):
    answer = answered(client, SCENE.request(**SHAPE, shape=box_shape(), loads=[shape_load()]))
    assert "observed" not in answer
    assert 0.0 < answer["loads"][0]["max_displacement_m"] < 0.2


@pytest.mark.parametrize(
    ("changes", "code", "field"),
    [
        ({"data": b64(b"\x00" * 100)}, "invalid_shape", "shape.data"),
        ({"data": b64(b"\x00" * 32768)}, "empty_object", "shape.data"),
        ({"voxel_size_m": 0.0}, "invalid_shape", "shape.voxel_size_m"),
        ({"voxel_size_m": NAN}, "invalid_shape", "shape.voxel_size_m"),
        ({"camera_from_grid": np.diag([1.0, 1.0, -1.0, 1.0]).tolist()}, "invalid_shape", "shape.camera_from_grid"),
        ({"camera_from_grid": np.diag([2.0, 2.0, 2.0, 1.0]).tolist()}, "invalid_shape", "shape.camera_from_grid"),
        ({"camera_from_grid": np.full((4, 4), NAN).tolist()}, "invalid_shape", "shape.camera_from_grid"),
        ({"camera_from_grid": np.eye(3).tolist()}, "invalid_shape", "shape.camera_from_grid[0][3]"),
        ({"encoding": "mesh"}, "invalid_request", "shape.encoding"),
    ],
)
def test_a_known_shape_that_is_none(client, changes, code, field):
    body = SCENE.request(**SHAPE, shape=box_shape() | changes, loads=[shape_load()])
    document = post(client, body).json()
    assert document["code"] == code or (document["code"] == "invalid_request" and "[" in field), document
    assert document["field"] == field


def test_a_known_shape_takes_no_contact_pixel(client):
    load = {"contact_px": [10, 10], "force_n": [0.0, 0.0, 1.0]}
    body = SCENE.request(**SHAPE, shape=box_shape(), loads=[load])
    refused(client, body, "invalid_request", "loads[0].contact_px")


def test_after_all_that_the_usual_request_has_the_usual_answer(client, live_service, usual_answer):
    refused(client, SCENE.request(depth=depth(b"")), "invalid_frame", "depth")
    again = answered(client, SCENE.request())
    for part in ("grid", "reconstruction", "observed", "loads", "flags"):
        assert again[part] == usual_answer[part]
    # Bad input is no news to an operator: nothing but named refusals in the log.
    assert "Traceback" not in live_service.logged()
    assert " ERROR " not in live_service.logged()
