"""The command line, in-process: what it prints, writes and returns."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from service.inference.artefacts import read_manifest
from service.inference.registry import load_models
from tests.training import tiny
from training.__main__ import main
from training.configs import RECONSTRUCTION_PRESETS
from training.data.generate import THREAD_VARIABLES
from training.data.store import Store


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    tiny.save_checkpoint(tiny.deformation_network(), tiny.FIT_DEFORMATION, tmp_path / "deformation")
    tiny.save_checkpoint(tiny.reconstruction_network(), tiny.FIT_RECONSTRUCTION, tmp_path / "reconstruction")
    return tmp_path


def test_from_checkpoints_to_models_that_a_service_opens(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = {
        "deformation": tiny.write_deformations(tmp_path / "boxes"),
        "reconstruction": tiny.write_views(tmp_path / "views"),
    }
    for kind, folder in data.items():
        arguments = ["--run", str(runs / kind), "--data", str(folder)]
        assert main(["evaluate", *arguments, "--split", "validation"]) == 0
        figures = json.loads(capsys.readouterr().out)
        assert figures["split"] == "validation"
        assert figures["samples"] == 2
        target = ["--models", str(tmp_path / "models"), "--name", f"{kind}-tiny", "--version", "0.2.0"]
        assert main(["export", *arguments, *target]) == 0
        assert f"{kind}-tiny 0.2.0: differs from torch by" in capsys.readouterr().out
    models = load_models(tmp_path / "models", threads=1)
    assert [manifest.name for manifest in models.manifests] == ["reconstruction-tiny", "deformation-tiny"]
    manifest = read_manifest(tmp_path / "models" / "deformation-tiny" / "0.2.0")
    assert manifest.evaluation["split"] == "test"
    # The range is that of the training split of the data set, log10 load numbers -2.5 and -2.2.
    assert manifest.condition_range["log10_load_number"] == pytest.approx((-2.503, -2.197), abs=1e-3)


def test_fit_refuses_a_run_of_another_configuration_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    data = tiny.write_views(tmp_path / "views")
    run = tmp_path / "run"
    network = tiny.reconstruction_network()
    checkpoint = tiny.save_checkpoint(network, tiny.FIT_RECONSTRUCTION, run, Store(data).manifest())
    before = checkpoint.read_bytes()
    arguments = ["--data", str(data), "--run", str(run), "--threads", "1", "--steps", "3"]
    assert main(["fit", "reconstruction", *arguments]) == 1
    error = capsys.readouterr().err
    assert error.splitlines()[-1].startswith("physnet-train: ")
    assert "was trained with another" in error.splitlines()[-1]
    assert "Traceback" not in error
    assert checkpoint.read_bytes() == before


@pytest.mark.parametrize("command", ["fit", "evaluate", "export"])
def test_a_folder_without_a_data_set_is_named(
    command: str, runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [command, *(["reconstruction"] if command == "fit" else [])]
    arguments += ["--data", str(tmp_path / "nothing"), "--run", str(runs / "reconstruction")]
    if command == "export":
        arguments += ["--name", "x", "--version", "0.1.0", "--models", str(tmp_path / "models")]
    assert main(arguments) == 1
    error = capsys.readouterr().err
    assert error.startswith("physnet-train: ")
    assert str(tmp_path / "nothing") in error


def test_reconstruction_goes_on_from_a_served_model_and_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(RECONSTRUCTION_PRESETS, "realtime", replace(RECONSTRUCTION_PRESETS["realtime"], batch=2))
    data, run, served = tiny.write_views(tmp_path / "views"), tmp_path / "run", shipped("reconstruction-realtime")
    arguments = ["--data", str(data), "--run", str(run), "--threads", "1", "--steps", "1", "--init-from", str(served)]
    assert main(["fit", "reconstruction", *arguments]) == 0
    config = torch.load(run / "checkpoint.pt", weights_only=True)["config"]
    assert config["begun_from"].startswith(f"reconstruction-realtime {served.name} as it is served, of run ")


def test_deformation_begins_with_runs_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data, served = tiny.write_deformations(tmp_path / "everyday"), shipped("deformation-realtime")
    arguments = ["--data", str(data), "--run", str(tmp_path / "run"), "--threads", "1", "--init-from", str(served)]
    assert main(["fit", "deformation", *arguments]) == 1
    assert str(served / "checkpoint.pt") in capsys.readouterr().err


def shipped(name: str) -> Path:
    (folder,) = (Path(__file__).parents[2] / "models" / name).iterdir()
    return folder


@pytest.mark.parametrize("command", ["evaluate", "export"])
def test_a_run_without_a_checkpoint_is_named(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [command, "--data", str(tmp_path), "--run", str(tmp_path / "no-run")]
    if command == "export":
        arguments += ["--name", "x", "--version", "0.1.0"]
    assert main(arguments) == 1
    assert "no-run" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["everyday", "views"])
def test_simulate_keeps_what_is_there_and_writes_how_it_was_made(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for variable in THREAD_VARIABLES:
        monkeypatch.setenv(variable, "1")
    store = Store(tmp_path)
    store.write_group(0, tiny.deformation_group(0))
    store.write_drop(1, "thin")
    assert main(["simulate", name, "--groups", "2", "--out", str(tmp_path), "--workers", "1", "--seed", "7"]) == 0
    assert "2 samples in 1 groups, dropped {'thin': 1}" in capsys.readouterr().err
    configuration = store.manifest()["configuration"]
    assert {key: configuration[key] for key in ("set", "groups", "seed")} == {"set": name, "groups": 2, "seed": 7}


def test_an_unknown_command_explains_itself(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["train"])
    assert "invalid choice: 'train'" in capsys.readouterr().err
