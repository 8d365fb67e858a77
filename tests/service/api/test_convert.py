"""From the wire to what the pipeline is asked."""

from __future__ import annotations

import base64

import numpy as np
import pytest

from service.core.errors import InvalidCamera, InvalidFrame, InvalidRequest, MaterialOutOfRange, UnknownMaterial
from service.core.messages import KnownShape, Observation
from tests.service.box_scene import BoxScene, asked, box_shape, npy

SCENE = BoxScene(width=32, height=24, focal_px=30.0)


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
