"""`physnet predict`: what it asks, what it prints and writes, with which code it ends."""

from __future__ import annotations

import json

import numpy as np
import pytest

from service import app
from service.__main__ import main
from service.app import Served
from service.commands.exits import FAILED, OK, REFUSED, USAGE
from service.core.errors import NoSupportPlane, Overloaded
from tests.service.box_scene import BoxScene, npy
from tests.service.fakes import FakePredictor, fake_manifest, running

SCENE = BoxScene(width=64, height=48, focal_px=60.0)


@pytest.fixture
def predictor(monkeypatch) -> FakePredictor:
    predictor = FakePredictor()
    monkeypatch.setattr(app, "build_pipeline", lambda settings: Served(predictor, [fake_manifest()]))
    return predictor


@pytest.fixture
def arguments(tmp_path) -> list[str]:
    (tmp_path / "depth.png").write_bytes(SCENE.depth_png())
    (tmp_path / "mask.png").write_bytes(SCENE.mask_png())
    # Calibration files carry more than we need.
    (tmp_path / "camera.json").write_text(json.dumps({**SCENE.camera, "sensor": "simulated", "depth_unit_m": 0.001}))
    return ["predict", str(tmp_path / "depth.png"), "--intrinsics", str(tmp_path / "camera.json")]


PUSH = ["--material", "silicone", "--press", "31,20", "--force", "-1,0,2.5"]


def test_it_asks_what_a_robot_would_post(predictor, arguments, tmp_path, capsys):
    out = tmp_path / "out.npz"
    options = ["--mask", str(tmp_path / "mask.png"), "--up", "0,-0.9,-0.4", "--patch-radius-m", "0.02", "-o", str(out)]
    assert main([*arguments, *PUSH, *options, "--json"]) == OK
    (request,) = predictor.asked
    assert request.source.depth.data == SCENE.depth_png()
    assert (request.source.depth.encoding, request.source.depth.unit_m) == ("png16", 0.001)
    assert request.source.mask.data == SCENE.mask_png()
    np.testing.assert_allclose(request.source.up, np.array([0, -0.9, -0.4]) / np.hypot(0.9, 0.4))
    (load,) = request.loads
    assert load.contact_px == (31.0, 20.0)
    assert load.patch_radius_m == 0.02
    np.testing.assert_array_equal(load.force_n, [-1.0, 0.0, 2.5])
    assert request.material.name == "silicone"
    report = json.loads(capsys.readouterr().out)
    assert report["max_displacement_m"] == 0.003
    assert report["flags"] == ["contact_snapped", "object_cut_by_border"]
    assert report["files"] == [str(out)]
    with np.load(out) as archive:
        assert archive["displacement_m"].shape[-4:] == (3, 64, 64, 64)


def test_it_prints_for_people_too(predictor, arguments, capsys):
    assert main([*arguments, *PUSH]) == OK
    told = capsys.readouterr().out
    assert "largest displacement  3.00 mm" in told
    assert "contact_snapped, object_cut_by_border" in told
    assert "\x1b[" not in told


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".bt", ".binvox"])
def test_it_writes_what_the_suffix_says(predictor, arguments, tmp_path, capsys, suffix):
    out = tmp_path / f"out{suffix}"
    assert main([*arguments, *PUSH, "-o", str(out), "-o", str(tmp_path / "out.npz")]) == OK
    assert out.stat().st_size > 1000
    assert str(out) in capsys.readouterr().out


def test_it_draws(predictor, arguments, tmp_path):
    pytest.importorskip("matplotlib")
    picture = tmp_path / "out.png"
    assert main([*arguments, *PUSH, "--picture", str(picture)]) == OK
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.parametrize("press", ["40,10", "0.02,-0.03,0.6"])
def test_a_force_without_direction_pushes_along_the_viewing_ray(predictor, arguments, press):
    assert main([*arguments, "--material", "1e5,0.45", "--press", press, "--force", "3"]) == OK
    (load,) = predictor.asked[0].loads
    assert np.linalg.norm(load.force_n) == pytest.approx(3.0)
    numbers = [float(part) for part in press.split(",")]
    if len(numbers) == 2:
        numbers = [(numbers[0] - SCENE.camera["cx"]) / 60.0, (numbers[1] - SCENE.camera["cy"]) / 60.0, 1.0]
    np.testing.assert_allclose(np.cross(load.force_n, numbers), 0.0, atol=1e-9)
    assert load.force_n @ np.array(numbers) > 0
    assert predictor.asked[0].material.poisson_ratio == 0.45


def test_a_direction_of_any_length(predictor, arguments):
    push = ["--material", "Shore A 30", "--press", "31,20", "--force", "5", "--direction", "-3,0,4"]
    assert main([*arguments, *push]) == OK
    (load,) = predictor.asked[0].loads
    np.testing.assert_allclose(load.force_n, [-3.0, 0.0, 4.0])
    assert predictor.asked[0].material.young_modulus_pa == pytest.approx(1.14e6, rel=0.01)


def test_intrinsics_as_numbers_take_the_size_from_the_image(predictor, arguments, tmp_path):
    arguments[3] = "60,61,31.5,23.5"
    assert main([*arguments, *PUSH]) == OK
    camera = predictor.asked[0].source.intrinsics
    assert (camera.fx, camera.fy, camera.cx, camera.cy) == (60.0, 61.0, 31.5, 23.5)
    assert (camera.width, camera.height) == (64, 48)


def test_a_numpy_depth_file_in_metres(predictor, arguments, tmp_path):
    (tmp_path / "depth.npy").write_bytes(npy(SCENE.render()[0].astype(np.float32)))
    arguments[1], arguments[3] = str(tmp_path / "depth.npy"), "60,60,31.5,23.5"
    assert main([*arguments, *PUSH, "--unit-m", "1"]) == OK
    source = predictor.asked[0].source
    assert source.depth.encoding == "npy"
    assert source.depth.unit_m == 1.0
    assert (source.intrinsics.width, source.intrinsics.height) == (64, 48)


def test_a_service_answers_the_same(arguments, tmp_path, capsys):
    with running(FakePredictor()) as service:
        assert main([*arguments, *PUSH, "--server", service.url, "--json"]) == OK
        report = json.loads(capsys.readouterr().out)
        assert report["max_displacement_m"] == 0.003
        assert report["request_id"]
        (request,) = service.predictor.asked
        assert request.source.depth.data == SCENE.depth_png()


def test_a_service_that_is_not_there_is_a_failure(arguments, capsys):
    assert main([*arguments, *PUSH, "--server", "http://127.0.0.1:9", "--json"]) == FAILED
    assert json.loads(capsys.readouterr().out)["code"] == "unreachable"


def test_a_refused_request_ends_with_its_own_code(predictor, arguments, capsys):
    def refuse(_) -> None:
        raise NoSupportPlane("No plane is visible.", field="up")

    predictor.react = refuse
    assert main([*arguments, *PUSH]) == REFUSED
    assert "no_support_plane [up]: No plane is visible." in capsys.readouterr().err
    assert main([*arguments, *PUSH, "--json"]) == REFUSED
    assert json.loads(capsys.readouterr().out)["code"] == "no_support_plane"


def test_a_service_that_cannot_answer_now_is_a_failure(predictor, arguments, capsys):
    def refuse(_) -> None:
        raise Overloaded("Full.", retry_after_s=1.0)

    predictor.react = refuse
    assert main([*arguments, *PUSH]) == FAILED
    assert "overloaded: Full." in capsys.readouterr().err


def test_an_unknown_material_is_refused_before_any_model_is_loaded(predictor, arguments, capsys):
    assert main([*arguments, "--material", "silicon", "--press", "1,1", "--force", "1"]) == REFUSED
    assert "silicone" in capsys.readouterr().err
    assert predictor.asked == []


@pytest.mark.parametrize(
    ("option", "value"),
    [("--press", "1"), ("--press", "a,b"), ("--force", "1,2"), ("--up", "0,1"), ("--press", "0,0,0"),
     ("--direction", "0,0,0"), ("--output", "out.stl"), ("--material", "1e5,")],
)  # fmt: skip
def test_wrong_usage_is_told(predictor, arguments, capsys, option, value):
    given = {"--material": "silicone", "--press": "31,20", "--force": "1", option: value}
    options = [part for pair in given.items() for part in pair]
    assert main([*arguments, *options]) == USAGE
    assert option in capsys.readouterr().err


def test_a_vector_and_a_direction_contradict_each_other(predictor, arguments, capsys):
    assert main([*arguments, *PUSH, "--direction", "1,0,0"]) == USAGE
    assert "--direction" in capsys.readouterr().err


def test_files_that_are_not_there(predictor, arguments, capsys):
    assert main([*arguments, *PUSH, "--picture", "nowhere/x.png"]) == USAGE
    assert "--picture: there is no folder nowhere" in capsys.readouterr().err
    arguments[1] += ".missing"
    assert main([*arguments, *PUSH]) == USAGE
    assert "depth.png.missing: no such file" in capsys.readouterr().err
    assert predictor.asked == []


@pytest.mark.parametrize("text", ["fx: 600", '{"fx": 1}', "[]"])
def test_intrinsics_that_cannot_be_used(predictor, arguments, capsys, tmp_path, text):
    (tmp_path / "camera.json").write_text(text)
    assert main([*arguments, *PUSH]) == USAGE
    assert "camera.json" in capsys.readouterr().err


def test_a_depth_file_of_another_kind(predictor, arguments, capsys, tmp_path):
    (tmp_path / "depth.png").write_bytes(b"GIF89a")
    assert main([*arguments, *PUSH]) == USAGE
    assert "neither PNG nor npy" in capsys.readouterr().err
