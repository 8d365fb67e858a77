"""From the wire to what the pipeline is asked, and from its answer to the wire."""

from __future__ import annotations

import base64
import io
import json
from dataclasses import replace

import numpy as np
import pytest

from service.api import convert
from service.api.scene import scene_glb
from service.api.schemas import DeformReply
from service.core.errors import InvalidCamera, InvalidFrame, InvalidRequest, MaterialOutOfRange, UnknownMaterial
from service.core.messages import KnownShape, Observation
from tests.service.box_scene import BoxScene, box_shape, npy
from tests.service.fakes import fake_result

SCENE = BoxScene(width=32, height=24, focal_px=30.0)
ALL = ["reconstruction", "deformed", "probability", "displacement"]


def asked(body: dict, files: dict[str, bytes] | None = None, max_loads: int = 8):
    return convert.deform_request(convert.parse_body(json.dumps(body).encode()), max_loads, files)


def test_a_frame_becomes_an_observation():
    request = asked(
        SCENE.request(
            up=[0.0, -2.0, 0.0],
            mask={"data": base64.b64encode(b"mask").decode()},
            roi=[1, 2, 3, 4],
            material={"name": "silicone"},
            threshold=0.4,
            uncertainty_samples=3,
            outputs=["deformed"],
        )
    )
    source = request.source
    assert isinstance(source, Observation)
    assert (source.depth.encoding, source.depth.unit_m) == ("png16", 0.001)
    assert source.depth.data == SCENE.depth_png()
    assert source.mask.encoding == "png8"
    assert source.mask.data == b"mask"
    np.testing.assert_allclose(source.up, [0.0, -1.0, 0.0])
    assert source.roi == (1, 2, 3, 4)
    assert source.intrinsics.fx == 30.0
    assert request.material.name == "silicone"
    assert request.outputs == {"deformed"}
    assert (request.threshold, request.uncertainty_samples) == (0.4, 3)


def test_what_is_optional_may_be_absent_or_null():
    bare = asked(SCENE.request())
    nulls = asked(SCENE.request(mask=None, up=None, roi=None, shape=None, threshold=None))
    for request in (bare, nulls):
        assert request.source.mask is None
        assert request.source.up is None
        assert request.source.roi is None
        assert request.outputs == {"reconstruction", "deformed"}
        assert request.uncertainty_samples == 0
        assert request.loads[0].patch_radius_m is None


def test_whole_numbers_are_numbers():
    load = {"contact_px": [3, 4], "force_n": [0, 1, 0]}
    request = asked(SCENE.request(loads=[load], material={"young_modulus_pa": 100000, "poisson_ratio": 0}))
    assert request.loads[0].contact_px == (3.0, 4.0)
    assert request.material.young_modulus_pa == 1e5


def test_a_known_shape():
    shape = box_shape()
    request = asked(SCENE.request(depth=..., camera=..., shape=shape, up=[0.0, -3.0, 0.0]))
    assert isinstance(request.source, KnownShape)
    assert len(request.source.data) == 32768
    assert request.source.pitch_m == shape["voxel_size_m"]
    np.testing.assert_array_equal(request.source.camera_from_grid, shape["camera_from_grid"])
    np.testing.assert_allclose(request.source.up, [0.0, -1.0, 0.0])


def test_a_multipart_request_takes_its_images_from_the_files():
    body = SCENE.request(depth={"encoding": "16UC1", "unit_m": 0.0001})
    request = asked(body, {"depth": b"depth bytes", "mask": b"mask bytes"})
    assert (request.source.depth.encoding, request.source.depth.data) == ("16UC1", b"depth bytes")
    assert request.source.depth.unit_m == 0.0001
    assert request.source.mask.data == b"mask bytes"


@pytest.mark.parametrize(
    ("data", "encoding"), [(SCENE.depth_png(), "png16"), (npy(np.zeros((2, 2), np.float32)), "npy")]
)
def test_a_depth_file_that_says_its_kind_needs_no_encoding(data, encoding):
    assert asked(SCENE.request(depth=...), {"depth": data}).source.depth.encoding == encoding


LOAD = SCENE.request()["loads"][0]


@pytest.mark.parametrize(
    ("changes", "files", "error", "field"),
    [
        ({"depth": ...}, None, InvalidRequest, "depth"),
        ({"shape": box_shape()}, None, InvalidRequest, "depth"),
        ({"camera": ...}, None, InvalidRequest, "camera"),
        ({"depth": {"encoding": "png16"}}, None, InvalidRequest, "depth.data"),
        ({"mask": {}}, None, InvalidRequest, "mask.data"),
        ({"depth": {"encoding": "png16"}}, {}, InvalidRequest, "depth"),
        ({"depth": {"encoding": "png16"}}, {"mask": b""}, InvalidRequest, "depth"),
        ({}, {"depth": b""}, InvalidRequest, "depth.data"),
        ({"depth": ...}, {"depth": b"\x00\x01"}, InvalidFrame, "depth.encoding"),
        ({"depth": ..., "shape": box_shape(), "mask": {"data": ""}}, None, InvalidRequest, "mask"),
        ({"camera": SCENE.camera | {"fx": 0.0}}, None, InvalidCamera, "camera.fx"),
        ({"camera": SCENE.camera | {"cy": float("nan")}}, None, InvalidCamera, "camera.cy"),
        ({"camera": SCENE.camera | {"distortion": [0.1]}}, None, InvalidCamera, "camera.distortion"),
        ({"up": [0.0, 0.0, 0.0]}, None, InvalidCamera, "up"),
        ({"up": [0.0, float("nan"), 0.0]}, None, InvalidCamera, "up"),
        ({"material": {}}, None, InvalidRequest, "material.young_modulus_pa"),
        ({"material": {"young_modulus_pa": 1e5}}, None, InvalidRequest, "material.poisson_ratio"),
        ({"material": {"name": "silicone", "poisson_ratio": 0.3}}, None, InvalidRequest, "material"),
        ({"material": {"name": "adamantium"}}, None, UnknownMaterial, "material.name"),
        (
            {"material": {"young_modulus_pa": 0, "poisson_ratio": 0.3}},
            None,
            MaterialOutOfRange,
            "material.young_modulus_pa",
        ),
        (
            {"material": {"young_modulus_pa": float("nan"), "poisson_ratio": 0.3}},
            None,
            MaterialOutOfRange,
            "material.young_modulus_pa",
        ),
        ({"loads": [LOAD] * 9}, None, InvalidRequest, "loads"),
        ({"loads": [LOAD, {"force_n": [0, 0, 1]}]}, None, InvalidRequest, "loads[1]"),
        ({"loads": [LOAD, LOAD | {"contact_px": [1, 1]}]}, None, InvalidRequest, "loads[1]"),
    ],
)
def test_a_request_that_contradicts_itself_is_refused_with_its_field(changes, files, error, field):
    with pytest.raises(error) as caught:
        asked(SCENE.request(**changes), files)
    assert type(caught.value) is error
    assert caught.value.field == field


def test_the_reply_fits_its_schema_and_keeps_every_voxel():
    request = asked(SCENE.request(loads=[LOAD, LOAD], outputs=ALL))
    result = fake_result(request)
    data = convert.reply_json(convert.reply_document(result, request.outputs, "r-7"), {"total": 3.0})
    reply = DeformReply.model_validate_json(data, strict=False)
    document = json.loads(data)
    assert reply.request_id == "r-7"
    assert reply.flags == ["object_cut_by_border"]
    assert document["grid"]["shape"] == [64, 64, 64]
    assert document["grid"]["camera_from_grid"][2] == [0.0, 0.0, 1.0, 0.5]

    def bits(part: dict) -> np.ndarray:
        packed = np.frombuffer(base64.b64decode(part["data"]), np.uint8)
        return np.unpackbits(packed, bitorder="little").reshape(64, 64, 64).astype(bool)

    np.testing.assert_array_equal(bits(document["observed"]), result.observed)
    np.testing.assert_array_equal(bits(document["reconstruction"]), result.reconstruction)
    np.testing.assert_array_equal(bits(document["loads"][1]["deformed"]), result.loads[1].deformed)
    levels = np.frombuffer(base64.b64decode(document["loads"][1]["probability"]["data"]), np.uint8)
    sent = levels.reshape(document["loads"][1]["probability"]["shape"]) / 255.0
    np.testing.assert_allclose(sent, result.loads[1].probability, atol=0.51 / 255)
    field = document["loads"][1]["displacement"]
    assert field["encoding"] == "float16"
    displacement = np.frombuffer(base64.b64decode(field["data"]), "<f2").reshape(field["shape"])
    np.testing.assert_allclose(displacement, result.loads[1].displacement_m, rtol=1e-3)
    assert document["loads"][1]["load_number"] == 0.02
    assert document["loads"][1]["flags"] == ["contact_snapped"]


@pytest.mark.parametrize(
    ("outputs", "top", "load"),
    [
        ([], set(), set()),
        (["reconstruction"], {"observed", "reconstruction"}, set()),
        (["deformed"], set(), {"deformed"}),
        (["deformed", "displacement"], set(), {"deformed", "displacement"}),
        (["probability"], set(), {"probability"}),
        (
            ALL,
            {"observed", "reconstruction", "reconstruction_probability"},
            {"deformed", "probability", "displacement"},
        ),
    ],
)
def test_outputs_choose_what_is_sent(outputs, top, load):
    request = asked(SCENE.request(outputs=outputs))
    document = convert.reply_document(fake_result(request), request.outputs, "id")
    always = {"request_id", "model", "grid", "loads", "flags"}
    assert set(document) - always == top
    scalars = {"max_displacement_m", "mean_displacement_m", "load_number", "flags"}
    assert set(document["loads"][0]) - scalars == load


def test_a_known_shape_has_nothing_observed():
    request = asked(SCENE.request(depth=..., shape=box_shape()))
    assert "observed" not in convert.reply_document(fake_result(request), request.outputs, "id")


def test_the_archive_holds_the_same():
    request = asked(SCENE.request(loads=[LOAD, LOAD], outputs=ALL))
    result = fake_result(request)
    result = replace(result, reconstruction_id="again")
    data = convert.reply_npz(result, request.outputs | {"scene"}, "r-7", {"total": 3.0})
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        np.testing.assert_array_equal(archive["reconstruction"], result.reconstruction)
        assert archive["reconstruction"].dtype == bool
        assert archive["deformed"].shape == (2, 64, 64, 64)
        np.testing.assert_array_equal(archive["deformed"][1], result.loads[1].deformed)
        np.testing.assert_allclose(archive["displacement_m"][0], result.loads[0].displacement_m, rtol=1e-3)
        np.testing.assert_allclose(archive["probability"][0], result.loads[0].probability, atol=1e-3)
        np.testing.assert_array_equal(archive["camera_from_grid"], result.grid.camera_from_grid)
        assert archive["voxel_size_m"] == result.grid.pitch_m
        np.testing.assert_array_equal(archive["max_displacement_m"], [0.003, 0.006])
        assert archive["scene"].tobytes() == scene_glb(result)
        meta = json.loads(str(archive["meta"]))
    assert (meta["request_id"], meta["reconstruction_id"]) == ("r-7", "again")
    assert meta["load_flags"] == [["contact_snapped"]] * 2
    assert meta["timing_ms"] == {"total": 3.0}
