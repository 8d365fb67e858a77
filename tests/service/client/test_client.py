"""What the client asks and is answered, on both wires of a service on real sockets."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from service.api import convert
from service.api.schemas import DeformBody
from service.client import Camera, Earlier, Image, NotInReply, Push, Shape, UnexpectedReply
from service.client.http_wire import displacement_from
from service.core import errors as core_errors
from service.core.messages import EarlierReconstruction, KnownShape, Observation
from tests.service.client.kinds import CAMERA, KINDS, PUSH, SCENE, SOFT, check, url
from tests.service.fakes import FakePredictor, fake_result, running


def test_a_depth_array_is_answered(client, service):
    result = client.deform(SCENE.counts(), CAMERA, PUSH, SOFT)
    asked = service.predictor.asked[-1]
    check(result, asked)
    np.testing.assert_array_equal(result.observed, fake_result(asked).observed)
    assert isinstance(asked.source, Observation)
    assert (asked.source.depth.encoding, asked.source.depth.data) == ("16UC1", SCENE.counts().tobytes())
    assert (asked.material.young_modulus_pa, asked.material.poisson_ratio) == SOFT
    np.testing.assert_allclose(asked.loads[0].contact_m, PUSH.contact_m)
    np.testing.assert_allclose(asked.loads[0].force_n, PUSH.force_n)


def test_displacements_travel_at_the_voxels_of_the_body_alone(client, service):
    """A thirtieth of the bytes; both forms of the field are there."""
    result = client.deform(SCENE.counts(), CAMERA, [PUSH, PUSH], SOFT, outputs=("deformed", "displacement"))
    assert service.predictor.asked[-1].outputs == {"deformed", "displacement_at_voxels"}
    for got, load in zip(result, fake_result(service.predictor.asked[-1]).loads, strict=True):
        np.testing.assert_array_equal(got.moved_m, load.moved_m.astype(np.float16))
        np.testing.assert_array_equal(got.displacement_m, load.displacement_m.astype(np.float16))
        assert got.moved_m.shape[1] == len(got.points_camera())
    # Where the body does not go along, nothing else says where its voxels are.
    result = client.deform(SCENE.counts(), CAMERA, PUSH, SOFT, outputs=("displacement",))
    assert service.predictor.asked[-1].outputs == {"displacement"}
    want_m = fake_result(service.predictor.asked[-1]).loads[0].displacement_m
    np.testing.assert_array_equal(result.displacement_m, want_m.astype(np.float16))
    with pytest.raises(NotInReply, match="'deformed'"):
        _ = result[0].moved_m


@pytest.mark.parametrize("kind", KINDS)
def test_a_service_that_knows_displacements_on_grids_alone_is_understood(kind, monkeypatch):
    """Over HTTP the field of the request is unknown to it and refused, once; over gRPC it is passed over."""
    original = convert.deform_request
    refused = []

    def of_before(body: DeformBody, *rest: Any) -> Any:
        if kind.startswith("http") and "displacement_form" in body.model_fields_set:
            refused.append(body)
            raise core_errors.InvalidRequest("`displacement_form` is not a field.", field="displacement_form")
        return original(body.model_copy(update={"displacement_form": "grid"}), *rest)

    monkeypatch.setattr(convert, "deform_request", of_before)
    with running(FakePredictor()) as service, KINDS[kind](url(service, kind)) as client:
        for _ in range(2):
            check(client.deform(SCENE.counts(), CAMERA, PUSH, SOFT), service.predictor.asked[-1])
            assert "displacement" in service.predictor.asked[-1].outputs
    assert len(refused) == (1 if kind.startswith("http") else 0)


def test_displacements_that_are_not_of_the_body_are_no_reply_of_ours():
    one = np.zeros((64, 64, 64), bool)
    one[3, 4, 5] = True
    np.testing.assert_array_equal(displacement_from(bytes(6), one).grid_m[:, one], np.zeros((3, 1)))
    for data, deformed in ((bytes(12), one), (bytes(8), one), (bytes(6), None)):
        with pytest.raises(UnexpectedReply):
            displacement_from(data, deformed)


def test_everything_that_can_be_asked_arrives(client, service):
    depth_m, mask = SCENE.render()
    camera = Camera.from_json(SCENE.camera | {"distortion": [0.01, 0.0, 0.0, 0.0, 0.0]})
    pushes = [Push((0, 0, 1), contact_px=(30, 20)), Push((1, 0, 0), contact_px=(31.5, 20), patch_radius_m=0.01)]
    result = client.deform(
        depth_m, camera, pushes, "silicone", mask=mask, up=np.array(SCENE.up), roi=(1, 2, 40, 30), unit_m=0.5,
        outputs=("reconstruction", "probability"), threshold=0.4, uncertainty_samples=3,
    )  # fmt: skip
    asked = service.predictor.asked[-1]
    source = asked.source
    assert (source.depth.encoding, source.depth.unit_m) == ("32FC1", 0.5)
    assert source.depth.data == depth_m.astype("<f4").tobytes()
    from service.core.depth import decode_mask

    np.testing.assert_array_equal(decode_mask("png8", source.mask.data, 64, 48), mask)
    np.testing.assert_allclose(source.up, np.array(SCENE.up) / np.linalg.norm(SCENE.up))
    assert (source.roi, source.intrinsics.distortion[0]) == ((1, 2, 40, 30), 0.01)
    assert (asked.material.name, asked.threshold, asked.uncertainty_samples) == ("silicone", 0.4, 3)
    assert [load.contact_px for load in asked.loads] == [(30.0, 20.0), (31.5, 20.0)]
    assert asked.loads[1].patch_radius_m == 0.01
    assert asked.outputs == {"reconstruction", "probability"}
    want = fake_result(asked)
    np.testing.assert_allclose(result[1].probability, want.loads[1].probability, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(result.body_probability, want.reconstruction_probability, atol=0.5 / 255 + 1e-6)
    with pytest.raises(NotInReply, match="'deformed'"):
        _ = result.deformed


def test_a_known_shape_is_answered(client, service):
    body = np.zeros((64, 64, 64), bool)
    body[20:44, 22:40, :30] = True
    pose = np.eye(4)
    pose[:3, 3] = (-0.1, -0.1, 0.4)
    result = client.deform(Shape(body, 0.003, pose), push=Push((0, 0, 2), contact_m=(0, 0, 0.5)), material=SOFT)
    asked = service.predictor.asked[-1]
    assert isinstance(asked.source, KnownShape)
    assert asked.source.data == np.packbits(body.ravel(), bitorder="little").tobytes()
    np.testing.assert_array_equal(asked.source.camera_from_grid, pose)
    check(result, asked)
    with pytest.raises(NotInReply):
        _ = result.observed


@pytest.mark.parametrize("encoding", ["png16", "npy", "compressedDepth", "32FC1; compressedDepth rvl"])
def test_bytes_go_as_they_came(client, service, encoding):
    client.deform(Image(encoding, b"\x00\x01" * 20, 0.002), CAMERA, PUSH, SOFT)
    depth = service.predictor.asked[-1].source.depth
    # The fake predictor decodes nothing, so what arrived is what was sent.
    assert (depth.encoding, depth.data, depth.unit_m) == (encoding, b"\x00\x01" * 20, 0.002)


def test_a_body_is_asked_about_again_by_its_id(client, service):
    """Without the frame: what was reconstructed once need not be again."""
    client.deform(Earlier("abc"), push=PUSH, material=SOFT)
    asked = service.predictor.asked[-1]
    assert asked.source == EarlierReconstruction("abc")
    with pytest.raises(NotInReply, match="send the frame again"):
        _ = client.deform(SCENE.counts(), CAMERA, PUSH, SOFT).earlier


def test_materials_and_models(client):
    found = client.materials("soft foam")
    assert {"foam_soft"} <= {entry.name for entry in found}
    entry = found[0]
    assert entry.young_modulus_range_pa[0] <= entry.young_modulus_pa <= entry.young_modulus_range_pa[1]
    assert client.models()[0]["name"] == "fake"
