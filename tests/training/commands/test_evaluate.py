import json
from dataclasses import replace
from pathlib import Path

import cv2
import pytest

import training.evaluate
from tests.training import tiny
from training.__main__ import main
from training.configs import HeldOut
from training.data.batches import DeformationSet
from training.data.contact_sheet import TILE
from training.networks.deformation import DeformationNetwork


@pytest.fixture(scope="module")
def data(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny.write_deformations(tmp_path_factory.mktemp("boxes"))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    tiny.save_checkpoint(tiny.deformation_network(), tiny.FIT_DEFORMATION, tmp_path / "run")
    return tmp_path / "run"


def test_a_report_holds_figures_rivals_splits_and_pictures(
    data: Path, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    strong = HeldOut(field="log10_load_number", low=-2.3)
    tiny.save_checkpoint(tiny.deformation_network(1), replace(tiny.FIT_DEFORMATION, held_out=strong), tmp_path / "kept")
    out = tmp_path / "out"
    arguments = [
        "evaluate",
        "--run",
        str(run),
        "--data",
        str(data),
        "--out",
        str(out),
        "--samples",
        "2",
        "--cells",
        "8",
    ]
    assert main([*arguments, "--also", str(data), "--held-out", str(tmp_path / "kept")]) == 0
    found, text = json.loads((out / "evaluation.json").read_text()), (out / "evaluation.md").read_text()
    assert found["samples"] == 4  # of the test split, whatever stands beside rivals
    assert found["comparison"]["samples"] == 2
    assert f"| skill | {found['skill']:.4f} |" in text
    assert text.split("\n\n", 2)[2] in capsys.readouterr().out
    others, kept = found["comparison"]["splits"]
    assert others["split"] == f"bodies of {data.name}"
    assert kept["split"] == "-2.3 ≤ log10_load_number, never trained on"
    assert kept["samples"] == 2  # every second load of the four on two bodies
    assert kept["network"]["iou"] != kept["network, trained on it"]["iou"]
    assert "network, trained on it" not in others
    assert f"| {others['split']} | 2 | {others['nothing moves']['iou']:.3f} | " in text
    for picture in ("curves.svg", "frontier.svg"):
        assert b"<svg" in (out / picture).read_bytes()
    sheet = cv2.imread(str(out / "worst.png"))
    assert sheet.shape == (2 * TILE, 2 * TILE, 3)  # two samples, true and given
    assert (sheet < 250).any(axis=2).mean() > 0.05


def test_the_share_of_the_correction_is_tuned_once_and_is_that_of_the_report(
    data: Path, run: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a correction that is told not at all the coarse solve is left."""
    tuned = []

    def nothing(_: DeformationNetwork, samples: DeformationSet) -> float:
        tuned.append(len(samples))
        return 0.0

    monkeypatch.setattr(training.evaluate, "tune_share", nothing)
    arguments = ["evaluate", "--run", str(run), "--data", str(data), "--out", str(tmp_path / "out"), "--cells"]
    assert main([*arguments, "--samples", "2"]) == 0
    assert tuned == [len(DeformationSet.load(data, "validation"))]
    found = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert found["correction_share"] == 0.0
    rows = found["comparison"]["bands"]["all"]
    assert rows["network"]["displacement_error"] == pytest.approx(rows["coarse solve alone"]["displacement_error"])


def test_a_report_of_views_holds_their_figures(tmp_path: Path) -> None:
    data = tiny.write_views(tmp_path / "views")
    tiny.save_checkpoint(tiny.reconstruction_network(), tiny.FIT_RECONSTRUCTION, tmp_path / "run")
    arguments = ["evaluate", "--run", str(tmp_path / "run"), "--data", str(data), "--out", str(tmp_path / "out")]
    assert main(arguments) == 0
    found = json.loads((tmp_path / "out" / "evaluation.json").read_text())
    assert "iou_occluded" in found
    assert "comparison" not in found
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["evaluation.json", "evaluation.md"]


def test_nothing_is_written_where_something_is_amiss(
    data: Path, run: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["evaluate", "--data", str(data), "--out", str(tmp_path / "no")]
    assert main([*arguments, "--run", str(tmp_path)]) == 1
    assert main([*arguments, "--run", str(run), "--held-out", str(run), "--samples", "1", "--cells"]) == 1
    assert "was trained on everything; there is nothing that it was kept from" in capsys.readouterr().err
    assert not (tmp_path / "no").exists()
