"""From the pipeline's answer to the wire."""

from __future__ import annotations

import base64
import io
import json
from dataclasses import replace

import numpy as np
import pytest

from service.api import replies
from service.api.scene import scene_glb
from service.api.schemas import DeformReply
from tests.service.box_scene import BoxScene, asked, box_shape
from tests.service.fakes import fake_result

SCENE = BoxScene(width=32, height=24, focal_px=30.0)
ALL = ["reconstruction", "deformed", "probability", "displacement"]
LOAD = SCENE.request()["loads"][0]


def test_the_reply_fits_its_schema_and_keeps_every_voxel():
    request = asked(SCENE.request(loads=[LOAD, LOAD], outputs=ALL))
    result = fake_result(request)
    data = replies.reply_json(replies.reply_document(result, request.outputs, "r-7"), {"total": 3.0})
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
    document = replies.reply_document(fake_result(request), request.outputs, "id")
    always = {"request_id", "model", "grid", "loads", "flags"}
    assert set(document) - always == top
    scalars = {"max_displacement_m", "mean_displacement_m", "load_number", "flags"}
    assert set(document["loads"][0]) - scalars == load


def test_a_known_shape_has_nothing_observed():
    request = asked(SCENE.request(depth=..., shape=box_shape()))
    assert "observed" not in replies.reply_document(fake_result(request), request.outputs, "id")


def test_the_archive_holds_the_same():
    request = asked(SCENE.request(loads=[LOAD, LOAD], outputs=ALL))
    result = fake_result(request)
    result = replace(result, reconstruction_id="again")
    data = replies.reply_npz(result, request.outputs | {"scene"}, "r-7", {"total": 3.0})
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
