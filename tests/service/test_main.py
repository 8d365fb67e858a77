"""The command line: what it prints and with which code it ends."""

from __future__ import annotations

import json

import numpy as np
import pytest

from service import app
from service.__main__ import FAILED, OK, REFUSED, USAGE, main
from service.app import Served
from service.core.errors import NoSupportPlane
from tests.service.box_scene import BoxScene, npy
from tests.service.fakes import FakePredictor, fake_manifest

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


def test_materials_are_listed_and_searched(capsys):
    assert main(["materials", "foam", "soft"]) == OK
    assert "foam_soft" in capsys.readouterr().out
    assert main(["materials", "--json", "steel"]) == OK
    (entry,) = json.loads(capsys.readouterr().out)["materials"]
    assert entry["young_modulus_pa"] == 2.1e11


def test_predict_asks_what_a_robot_would_post(predictor, arguments, tmp_path, capsys):
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
    with np.load(out) as archive:
        assert archive["displacement_m"].shape == (1, 3, 64, 64, 64)


def test_predict_prints_for_people_too(predictor, arguments, capsys):
    assert main([*arguments, *PUSH]) == OK
    assert "largest displacement  3.00 mm" in capsys.readouterr().out


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


def test_a_numpy_depth_file_in_metres(predictor, arguments, tmp_path):
    (tmp_path / "depth.npy").write_bytes(npy(SCENE.render()[0].astype(np.float32)))
    arguments[1] = str(tmp_path / "depth.npy")
    assert main([*arguments, *PUSH, "--unit-m", "1"]) == OK
    assert predictor.asked[0].source.depth.encoding == "npy"
    assert predictor.asked[0].source.depth.unit_m == 1.0


def test_a_refused_request_ends_with_its_own_code(predictor, arguments, capsys):
    def refuse(_) -> None:
        raise NoSupportPlane("No plane is visible.", field="up")

    predictor.react = refuse
    assert main([*arguments, *PUSH]) == REFUSED
    assert "no_support_plane [up]: No plane is visible." in capsys.readouterr().err
    assert main([*arguments, *PUSH, "--json"]) == REFUSED
    assert json.loads(capsys.readouterr().out)["code"] == "no_support_plane"


def test_an_unknown_material_is_refused_before_any_model_is_loaded(predictor, arguments, capsys):
    assert main([*arguments, "--material", "silicon", "--press", "1,1", "--force", "1"]) == REFUSED
    assert "silicone" in capsys.readouterr().err
    assert predictor.asked == []


@pytest.mark.parametrize(
    ("option", "value"),
    [("--press", "1"), ("--press", "a,b"), ("--force", "1,2"), ("--up", "0,1"), ("--press", "0,0,0")],
)
def test_wrong_usage_is_told(predictor, arguments, capsys, option, value):
    given = {"--press": "31,20", "--force": "1", option: value}
    options = [part for pair in given.items() for part in pair]
    assert main([*arguments, "--material", "silicone", *options]) == USAGE
    assert option in capsys.readouterr().err


def test_files_that_are_not_there(predictor, arguments, capsys):
    arguments[1] += ".missing"
    assert main([*arguments, *PUSH]) == FAILED
    assert "depth.png.missing" in capsys.readouterr().err


def test_intrinsics_that_are_no_json(predictor, arguments, capsys, tmp_path):
    (tmp_path / "camera.json").write_text("fx: 600")
    assert main([*arguments, *PUSH]) == USAGE
    assert "camera.json" in capsys.readouterr().err


def test_a_wrong_setting_names_its_variable(monkeypatch, capsys):
    monkeypatch.setenv("PHYSNET_QUEUE_SIZE", "many")
    assert main(["serve"]) == USAGE
    assert "PHYSNET_QUEUE_SIZE" in capsys.readouterr().err


def test_a_directory_without_models_is_a_failure(tmp_path, capsys):
    assert main(["models", "--models", str(tmp_path)]) == FAILED
    assert str(tmp_path) in capsys.readouterr().err
    assert main(["serve", "--models", str(tmp_path), "--http-port", "0", "--grpc-port", "0"]) == FAILED


def test_no_command_is_wrong_usage(capsys):
    with pytest.raises(SystemExit) as caught:
        main([])
    assert caught.value.code == USAGE
    assert "serve" in capsys.readouterr().err
