"""Somebody's own objects: from a folder of mesh files to a model that answers."""

from __future__ import annotations

import dataclasses
import functools
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from service.__main__ import main as physnet
from tests.conftest import ROOT
from tests.training import tiny
from training.__main__ import main
from training.configs import DEFORMATION_PRESETS
from training.data import meshes
from training.data.catalogue import DataSet
from training.data.everyday import EverydayConfig
from training.data.generate import THREAD_VARIABLES, Dropped
from training.data.meshes import draw_group, meshes_in
from training.data.store import Store
from training.simulation.mesh import MeshError

QUICK = functools.partial(EverydayConfig, cells=16, loads=2, fractions=None, identity_iou=(0.6, 0.9))
"""A coarse grid, gentle pushes, the linear law."""


@pytest.fixture(autouse=True)
def _threads_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in THREAD_VARIABLES:
        monkeypatch.setenv(variable, "1")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A brick and a barrel in millimetres, and a sheet that is no body."""
    found = tmp_path / "objects"
    (found / "more").mkdir(parents=True)
    trimesh.creation.box((80.0, 60.0, 50.0)).export(found / "brick.stl")
    trimesh.creation.cylinder(30.0, 80.0, sections=24).export(found / "more" / "barrel.obj")
    trimesh.Trimesh([[0, 0, 0], [50, 0, 0], [0, 50, 0]], [[0, 1, 2]]).export(found / "sheet.ply")
    (found / "notes.txt").write_text("not a mesh")
    return found


def test_every_mesh_of_a_folder_is_found_with_its_digest(folder: Path) -> None:
    config = meshes_in(folder, 1e-3)
    assert [name for name, _ in config.files] == ["brick.stl", "more/barrel.obj", "sheet.ply"]
    before = dict(config.files)["brick.stl"]
    trimesh.creation.box((80.0, 60.0, 51.0)).export(folder / "brick.stl")
    assert dict(meshes_in(folder, 1e-3).files)["brick.stl"] != before


def test_a_folder_without_meshes_is_told(tmp_path: Path) -> None:
    with pytest.raises(MeshError, match=r"\.stl"):
        meshes_in(tmp_path)


def test_a_mesh_comes_first_as_it_is_and_then_stretched(folder: Path) -> None:
    config = dataclasses.replace(meshes_in(folder, 1e-3), pushes=QUICK())
    one, again, other = (draw_group(config, index) for index in (0, 3, 1))
    assert (str(one["family"]), str(other["family"])) == ("brick", "barrel")
    assert str(again["family"]) == "brick"
    assert not np.array_equal(one["rest"], again["rest"])
    with pytest.raises(Dropped, match="mesh"):
        draw_group(config, 2)


def test_a_set_of_meshes_can_be_written_down(folder: Path) -> None:
    configuration = json.loads(json.dumps(DataSet(meshes_in(folder), 3, "").configuration("meshes", 3)))
    assert configuration["set"] == "meshes"
    assert len(configuration["files"]) == 3


@pytest.mark.parametrize("arguments", [["everyday", "--meshes", "."], ["meshes"]])
def test_the_set_and_the_folder_belong_together(
    arguments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", *arguments, "--out", str(tmp_path / "set")]) == 2
    assert "--meshes" in capsys.readouterr().err


@pytest.mark.timeout(600)  # a whole training, however small, on a machine that may be busy
def test_from_a_folder_of_meshes_to_an_answer_in_three_commands(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """docs/retrain.md at small size: a coarse simulation and a network of a few channels, all else real."""
    monkeypatch.setattr(meshes, "EverydayConfig", QUICK)
    monkeypatch.setitem(DEFORMATION_PRESETS, "tiny", tiny.FIT_DEFORMATION)
    data, run, models = tmp_path / "data", tmp_path / "run", tmp_path / "models"
    simulate = ["simulate", "meshes", "--meshes", str(folder), "--unit", "mm", "--groups", "6", "--workers", "1"]
    assert main([*simulate, "--out", str(data)]) == 0
    # The sheet is left out before anything is drawn, and the others are still enough.
    assert "left out: sheet.ply is not watertight" in capsys.readouterr().err
    assert Store(data).manifest()["groups"] >= 4  # a push may find no equilibrium, whatever the body
    fit = ["fit", "deformation", "--data", str(data), "--run", str(run)]
    assert main([*fit, "--preset", "tiny", "--threads", "1"]) == 0
    export = ["export", "--run", str(run), "--data", str(data), "--models", str(models)]
    assert main([*export, "--name", "deformation-mine", "--version", "0.1.0"]) == 0
    shutil.copytree(ROOT / "models/reconstruction-realtime", models / "reconstruction-realtime")
    frame = ROOT / "examples/frames/mug"
    push = ["--material", "dragon_skin_10", "--press", "365,215", "--force", "10"]
    capsys.readouterr()
    ask = ["predict", str(frame / "depth.png"), "--intrinsics", str(frame / "intrinsics.json"), *push, "--json"]
    assert physnet([*ask, "--models", str(models), "--threads", "1"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["model"] == {"name": "deformation-mine", "version": "0.1.0"}
    assert answer["max_displacement_m"] > 0
