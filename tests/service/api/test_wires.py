"""Both wires of one real service: the same question has the same answer, bit for bit, and the same refusal."""

from __future__ import annotations

import base64
import io
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import grpc
import httpx
import numpy as np
import pytest

from service.api.status import meanings
from tests.conftest import LiveService
from tests.service import rpc_client
from tests.service.box_scene import BoxScene, b64, box_shape, npy, png

SCENE = BoxScene()
COUNTS = SCENE.counts()
LOAD = SCENE.request()["loads"][0]
NAN = float("nan")
OFF = SCENE.in_camera((0.0, 0.0, SCENE.size_m[2] + 0.30))


@dataclass(frozen=True)
class Wires:
    http: httpx.Client
    grpc: Any

    def over_http(self, body: dict[str, Any]) -> tuple[int, dict[str, Any]]:
        # Python's own JSON writes NaN, as many robots' do.
        reply = self.http.post("/v1/deform", content=json.dumps(body), headers={"Content-Type": "application/json"})
        return reply.status_code, reply.json()

    def over_grpc(self, body: dict[str, Any]) -> tuple[str, dict[str, Any]]:
        try:
            return "OK", rpc_client.document(self.grpc.Deform(rpc_client.message(body), timeout=30))
        except grpc.RpcError as error:
            return error.code().name, rpc_client.problem(error)


@pytest.fixture(scope="module")
def wires(live_service: LiveService) -> Iterator[Wires]:
    with (
        httpx.Client(base_url=live_service.url, timeout=30) as client,
        grpc.insecure_channel(live_service.grpc, rpc_client.LIMITS) as channel,
    ):
        yield Wires(client, rpc_client.stub(channel))


def depth(data: bytes, encoding: str = "png16", unit_m: float | None = None) -> dict[str, Any]:
    return {"encoding": encoding, "unit_m": unit_m, "data": b64(data)}


def shape(**changes: Any) -> dict[str, Any]:
    load = {"contact_m": [0.0, 0.05, 0.55], "force_n": [0.0, 0.0, 2.0]}
    return SCENE.request(depth=..., camera=..., shape=box_shape() | changes, loads=[load])


ANSWERED: dict[str, Callable[[], dict[str, Any]]] = {
    "png": SCENE.request,
    "npy in metres": lambda: SCENE.request(depth=depth(npy(SCENE.render()[0].astype(np.float32)), "npy")),
    "raw integers": lambda: SCENE.request(depth=depth(COUNTS.tobytes(), "16UC1", 0.001)),
    "raw floats": lambda: SCENE.request(depth=depth(SCENE.render()[0].astype("<f4").tobytes(), "32FC1")),
    "mask, up and roi": lambda: SCENE.request(
        mask={"encoding": "png8", "data": b64(SCENE.mask_png())}, up=SCENE.up, roi=[0, 0, 320, 240]
    ),
    "distortion": lambda: SCENE.request(camera=SCENE.camera | {"distortion": [0.01, 0.0, 0.0, 0.0]}),
    "all outputs": lambda: SCENE.request(outputs=["reconstruction", "deformed", "probability", "displacement"]),
    "displacements at voxels": lambda: SCENE.request(
        outputs=["deformed", "displacement"], displacement_form="voxels", loads=[LOAD, LOAD | {"force_n": [0, 0, 0]}],
    ),
    "displacements on the grid": lambda: SCENE.request(outputs=["displacement"], displacement_form="grid"),
    "numbers only": lambda: SCENE.request(outputs=[]),
    "threshold and samples": lambda: SCENE.request(threshold=0.4, uncertainty_samples=2),
    "named material": lambda: SCENE.request(material={"name": "silicone"}),
    "clamped material": lambda: SCENE.request(material={"young_modulus_pa": 1e5, "poisson_ratio": 0.5}),
    "many loads": lambda: SCENE.request(
        loads=[LOAD, LOAD | {"force_n": [0.0, 0.0, 0.0]}, LOAD | {"patch_radius_m": 0.01},
               {"contact_px": SCENE.pixel(SCENE.front_m()), "force_n": SCENE.direction((0.0, 1.0, -1.0))}],
    ),
    "far beyond training": lambda: SCENE.request(loads=[LOAD | {"force_n": SCENE.direction((0.0, 1e6, 0.0))}]),
    "known shape": shape,
    "cut by the border": lambda: replace(SCENE, aim_offset_m=(-0.30, 0.0, 0.0)).request(
        loads=[{"contact_px": [314, 110], "force_n": [0.0, 0.0, 1.0]}]
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ANSWERED)
def test_the_same_question_has_the_same_answer(wires, name):
    body = ANSWERED[name]()
    http_status, by_http = wires.over_http(body)
    grpc_status, by_grpc = wires.over_grpc(body)
    assert (http_status, grpc_status) == (200, "OK"), (by_http, by_grpc)
    assert set(by_grpc["timing_ms"]) == set(by_http["timing_ms"])
    assert by_http["reconstruction_id"] != by_grpc["reconstruction_id"]
    assert without_names(by_grpc) == without_names(by_http)


def without_names(answer: dict[str, Any]) -> dict[str, Any]:
    """What two answers to one question share."""
    assert answer["timing_ms"]["total"] > 0.0
    assert answer["request_id"]
    return {
        key: value for key, value in answer.items() if key not in ("timing_ms", "request_id", "reconstruction_id")
    }


@pytest.mark.parametrize("wire", ["http", "grpc", "npz"])
def test_displacements_at_voxels_are_those_of_the_grid(wires, wire):
    """Put back where `deformed` says, bit for bit."""
    on_grid = ANSWERED["many loads"]() | {"outputs": ["deformed", "displacement"]}
    at_voxels = on_grid | {"displacement_form": "voxels"}
    if wire == "npz":
        npz = {"Accept": "application/x-npz"}
        replies = (wires.http.post("/v1/deform", json=body, headers=npz) for body in (on_grid, at_voxels))
        want, got = (np.load(io.BytesIO(reply.content)) for reply in replies)
        assert "displacement_m" not in got and "displacement_at_voxels_m" not in want
        deformed, want_m, moved_m = got["deformed"], want["displacement_m"], got["displacement_at_voxels_m"]
    else:
        ask = wires.over_http if wire == "http" else wires.over_grpc
        (_, want), (_, got) = ask(on_grid), ask(at_voxels)
        assert not any("displacement" in load for load in got["loads"])
        assert not any("displacement_at_voxels" in load for load in want["loads"])
        deformed = np.array([bits_of(load["deformed"]) for load in got["loads"]])
        want_m = np.array([halves_of(load["displacement"]) for load in want["loads"]])
        moved_m = np.concatenate([halves_of(load["displacement_at_voxels"]) for load in got["loads"]], axis=1)
    assert moved_m.shape == (3, deformed.sum())
    field_m = np.zeros((3, *deformed.shape), np.float16)
    field_m[:, deformed] = moved_m
    np.testing.assert_array_equal(field_m.swapaxes(0, 1), want_m)
    assert np.abs(field_m).max() > 0.0


def bits_of(grid: dict[str, Any]) -> np.ndarray:
    packed = np.frombuffer(base64.b64decode(grid["data"]), np.uint8)
    return np.unpackbits(packed, bitorder="little").reshape(64, 64, 64).astype(bool)


def halves_of(grid: dict[str, Any]) -> np.ndarray:
    return np.frombuffer(base64.b64decode(grid["data"]), "<f2").reshape(grid["shape"])


ALL = ["reconstruction", "deformed", "probability", "displacement", "scene"]


@pytest.mark.parametrize("name", ["many loads", "known shape", "threshold and samples"])
def test_a_reconstruction_is_asked_again_by_its_id_on_either_wire(wires, name):
    """Both wires share what is kept, and the answer is that of the first call, bit for bit."""
    first = ANSWERED[name]() | {"outputs": ALL[:-1]}
    _, answered = wires.over_http(first)
    source = {key: first[key] for key in first if key not in ("camera", "depth", "shape", "mask", "up", "roi")}
    again = source | {"reconstruction_id": answered["reconstruction_id"]}
    frame = rpc_client.pb.DeformStreamRequest(frame_id=1, request=rpc_client.message(again))
    (streamed,) = wires.grpc.DeformStream(iter([frame]), timeout=30)
    by_stream = ("OK", rpc_client.document(streamed.answer))
    for status, answer in (wires.over_http(again), wires.over_grpc(again), by_stream):
        assert status in (200, "OK"), answer
        assert answer["reconstruction_id"] == answered["reconstruction_id"]
        assert without_names(answer) == without_names(answered)
        assert not {"decode", "segment", "voxelize", "reconstruct", "align"} & set(answer["timing_ms"])
    _, harder = wires.over_http(again | {"material": {"young_modulus_pa": 2e4, "poisson_ratio": 0.3}})
    assert harder["loads"][0]["max_displacement_m"] != answered["loads"][0]["max_displacement_m"]
    assert harder["reconstruction"] == answered["reconstruction"]


def test_a_scene_is_the_same_on_both_wires_and_as_a_document_of_its_own(wires):
    _, first = wires.over_http(SCENE.request(outputs=[]))
    body = {
        "reconstruction_id": first["reconstruction_id"], "material": {"name": "silicone"}, "outputs": ["scene"],
        "loads": SCENE.request()["loads"],
    }  # fmt: skip
    _, by_http = wires.over_http(body)
    _, by_grpc = wires.over_grpc(body)
    alone = wires.http.post("/v1/deform", json=body, headers={"Accept": "model/gltf-binary"})
    assert alone.headers["content-type"] == "model/gltf-binary"
    assert by_http["scene"] == by_grpc["scene"] == {"encoding": "glb", "data": b64(alone.content)}
    assert "reconstruction" not in by_http and "reconstruction" not in by_grpc


def without(document: dict[str, Any], name: str) -> dict[str, Any]:
    return {key: value for key, value in document.items() if key != name}


REFUSED: dict[str, tuple[str, str | None, Callable[[], dict[str, Any]]]] = {
    # An empty list and none are the same in protobuf.
    "nothing at all": ("invalid_request", "material", lambda: {"loads": []}),
    "no material": ("invalid_request", "material", lambda: SCENE.request(material=...)),
    "no loads": ("invalid_request", "loads", lambda: SCENE.request(loads=[])),
    "no camera": ("invalid_request", "camera", lambda: SCENE.request(camera=...)),
    "no cx": ("invalid_request", "camera.cx", lambda: SCENE.request(camera=without(SCENE.camera, "cx"))),
    "an earlier one that is not there": (
        "reconstruction_gone", "reconstruction_id",
        lambda: SCENE.request(depth=..., camera=..., reconstruction_id="f" * 32),
    ),
    "an earlier one and a frame": ("invalid_request", "depth", lambda: SCENE.request(reconstruction_id="f" * 32)),
    "an earlier one by another camera": (
        "invalid_request", "camera", lambda: SCENE.request(depth=..., reconstruction_id="f" * 32)
    ),
    "an id as long as a book": (
        "invalid_request", "reconstruction_id", lambda: SCENE.request(depth=..., reconstruction_id="f" * 1000)
    ),
    "neither depth nor shape": ("invalid_request", "depth", lambda: SCENE.request(depth=...)),
    "both depth and shape": ("invalid_request", "depth", lambda: SCENE.request(shape=box_shape())),
    "no encoding": ("invalid_request", "depth.encoding", lambda: SCENE.request(depth={"data": b64(b"x")})),
    "no data": ("invalid_request", "depth.data", lambda: SCENE.request(depth={"encoding": "png16"})),
    "no force": ("invalid_request", "loads[0].force_n", lambda: SCENE.request(loads=[without(LOAD, "force_n")])),
    "no contact": ("invalid_request", "loads[0]", lambda: SCENE.request(loads=[without(LOAD, "contact_m")])),
    "two contacts": ("invalid_request", "loads[0]", lambda: SCENE.request(loads=[LOAD | {"contact_px": [1, 1]}])),
    "two faults": (
        "invalid_request", "loads[0].force_n",
        lambda: SCENE.request(loads=[without(LOAD, "force_n"), LOAD | {"patch_radius_m": -1.0}]),
    ),
    "a force that is nan": (
        "invalid_request", "loads[0].force_n[1]", lambda: SCENE.request(loads=[LOAD | {"force_n": [0.0, NAN, 0.0]}])
    ),
    "no patch": ("invalid_request", "loads[0].patch_radius_m",
                 lambda: SCENE.request(loads=[LOAD | {"patch_radius_m": 0.0}])),
    "too many loads": ("invalid_request", "loads", lambda: SCENE.request(loads=[LOAD] * 1000)),
    "threshold": ("invalid_request", "threshold", lambda: SCENE.request(threshold=1.0)),
    "voxels of a body that is not told": (
        "invalid_request", "displacement_form",
        lambda: SCENE.request(outputs=["displacement"], displacement_form="voxels"),
    ),
    "samples": ("invalid_request", "uncertainty_samples", lambda: SCENE.request(uncertainty_samples=65)),
    "roi outside": ("invalid_request", "roi", lambda: SCENE.request(roi=[400, 0, 10, 10])),
    "pixel outside": ("invalid_request", "loads[0].contact_px", lambda: SCENE.request(
        loads=[{"contact_px": [-1.0, 10.0], "force_n": [0.0, 0.0, 1.0]}])),
    "truncated png": ("invalid_frame", "depth", lambda: SCENE.request(depth=depth(SCENE.depth_png()[:200]))),
    "another size": (
        "invalid_frame", "depth", lambda: SCENE.request(camera=SCENE.camera | {"width": 640, "height": 480})
    ),
    "no reading": ("invalid_frame", "depth", lambda: SCENE.request(depth=depth(png(COUNTS * 0)))),
    "unit": ("invalid_frame", "depth.unit_m", lambda: SCENE.request(depth=depth(SCENE.depth_png(), unit_m=NAN))),
    "focal length": ("invalid_camera", "camera.fx", lambda: SCENE.request(camera=SCENE.camera | {"fx": 0.0})),
    "principal point": ("invalid_camera", "camera.cx", lambda: SCENE.request(camera=SCENE.camera | {"cx": NAN})),
    "distortion": ("invalid_camera", "camera.distortion",
                   lambda: SCENE.request(camera=SCENE.camera | {"distortion": [0.1]})),
    "up": ("invalid_camera", "up", lambda: SCENE.request(up=[0.0, 0.0, 0.0])),
    "shape of 100 bytes": ("invalid_shape", "shape.data", lambda: shape(data=b64(bytes(100)))),
    "scaled pose": (
        "invalid_shape", "shape.camera_from_grid",
        lambda: shape(camera_from_grid=np.diag([2.0, 2.0, 2.0, 1.0]).tolist()),
    ),
    "empty shape": ("empty_object", "shape.data", lambda: shape(data=b64(bytes(32768)))),
    "empty mask": (
        "empty_object", "mask", lambda: SCENE.request(mask={"data": b64(png(np.zeros(COUNTS.shape, "u1")))})
    ),
    "no plane": (
        "no_support_plane", "up", lambda: replace(SCENE, table_half_m=0.0, elevation_rad=0.6).request()
    ),
    "contact off the body": (
        "contact_off_body", "loads[1].contact_m", lambda: SCENE.request(loads=[LOAD, LOAD | {"contact_m": OFF}])
    ),
    "stiffness": ("material_out_of_range", "material.young_modulus_pa",
                  lambda: SCENE.request(material={"young_modulus_pa": 0.0, "poisson_ratio": 0.3})),
    "unknown material": (
        "unknown_material", "material.name", lambda: SCENE.request(material={"name": "silicon"})
    ),
    "half a material": ("invalid_request", "material.poisson_ratio",
                        lambda: SCENE.request(material={"young_modulus_pa": 1e5})),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_the_same_fault_has_the_same_refusal(wires, name):
    code, field, make = REFUSED[name]
    body = make()
    http_status, by_http = wires.over_http(body)
    grpc_status, by_grpc = wires.over_grpc(body)
    assert (by_http["code"], by_http.get("field")) == (code, field), by_http
    assert (http_status, grpc_status) == (meanings()[code].http, meanings()[code].grpc)
    for problem in (by_http, by_grpc):
        assert problem.pop("request_id")
    for name in ("type", "title", "status"):
        by_http.pop(name)
    assert by_grpc == by_http


def test_a_frame_of_a_hundred_megapixels_is_too_large_on_both(wires):
    camera = SCENE.camera | {"width": 10_000, "height": 10_000}
    body = SCENE.request(camera=camera, depth=depth(png(np.zeros((10_000, 10_000), np.uint16))))
    http_status, by_http = wires.over_http(body)
    grpc_status, by_grpc = wires.over_grpc(body)
    assert (http_status, grpc_status) == (413, "RESOURCE_EXHAUSTED")
    for name in ("code", "field", "expected", "actual", "detail"):
        assert by_grpc[name] == by_http[name]


def test_materials_and_models_are_the_same(wires):
    listed = wires.http.get("/v1/materials", params={"q": "foam"}).json()["materials"]
    messages = wires.grpc.ListMaterials(rpc_client.pb.ListMaterialsRequest(query="foam")).materials
    assert [entry["name"] for entry in listed] == [entry.name for entry in messages]
    for entry, message in zip(listed, messages, strict=True):
        assert entry["young_modulus_range_pa"] == [message.young_modulus_min_pa, message.young_modulus_max_pa]
        for name in ("young_modulus_pa", "poisson_ratio", "description", "source"):
            assert entry[name] == getattr(message, name)
    models = wires.grpc.GetModel(rpc_client.pb.GetModelRequest()).models
    assert [json.loads(model.manifest_json) for model in models] == wires.http.get("/v1/models").json()["models"]
    assert {model.kind for model in models} == {"reconstruction", "deformation"}
    one = wires.grpc.GetModel(rpc_client.pb.GetModelRequest(name=models[1].name)).models
    assert [model.name for model in one] == [models[1].name]
    assert one[0].condition_range["poisson_ratio"].high > 0.4


def test_a_large_frame_of_floats_fits_both(wires):
    """1080p, 32-bit floats: 8 MiB, beyond gRPC's own default of 4."""
    large = BoxScene(width=1920, height=1080, focal_px=1400.0)
    body = large.request(depth=depth(large.render()[0].astype("<f4").tobytes(), "32FC1"))
    _, by_http = wires.over_http(body)
    status, by_grpc = wires.over_grpc(body)
    assert status == "OK", by_grpc
    assert by_grpc["reconstruction"] == by_http["reconstruction"]
    assert by_grpc["loads"] == by_http["loads"]
