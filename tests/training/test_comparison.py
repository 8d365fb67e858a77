from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.training import tiny
from training.comparison import compare, contenders, markdown, report
from training.data.batches import DeformationSet
from training.data.contact_sheet import TILE


@pytest.fixture(scope="module")
def sets(tmp_path_factory: pytest.TempPathFactory) -> tuple[DeformationSet, DeformationSet]:
    root = tiny.write_deformations(tmp_path_factory.mktemp("deformations"))
    return DeformationSet.load(root, "train", prior=False), DeformationSet.load(root, "test")


def test_every_rival_is_scored_on_the_same_samples(sets: tuple[DeformationSet, DeformationSet]) -> None:
    training, test = sets
    rows = np.arange(len(test))
    table = compare(contenders(tiny.deformation_network(), 0.5, training, [8], [6]), test, rows)
    assert [scores.name for scores in table] == [
        "nothing moves", "mean training shape", "4 nearest conditions", "linear FEM, 8³",
        "neo-Hookean FEM, 6³", "coarse solve alone", "network",
    ]  # fmt: skip
    np.testing.assert_allclose(table[0].iou, test.identity_iou, atol=1e-6)
    # A solve costs its time although the set has kept its answer.
    assert table[5].ms > table[0].ms
    assert not table[0].changed.any()
    # The blocks are sheared, which no solve of theirs would do; but they are pushed that way.
    assert table[5].iou.mean() > table[1].iou.mean()
    found = report(table, test, rows)
    assert found["bands"]["all"]["nothing moves"]["skill"] == pytest.approx(0.0, abs=1e-6)
    assert found["bands"]["family: box"]["samples"] == len(test) == found["samples"]
    assert len(found["worst"]) == min(10, len(test))
    for parts in found["curves"].values():
        assert sum(part["samples"] for part in parts) == len(test)
        middles = [part["middle"] for part in parts]
        assert middles == sorted(middles)
        everywhere = np.average([part["iou"]["network"] for part in parts], weights=[p["samples"] for p in parts])
        assert everywhere == pytest.approx(table[-1].iou.mean())
    voxels, said, true = np.array(found["calibration"]["nothing moves"])
    assert not voxels[1:-1].any()  # it is always sure: what counts is where it is wrong
    assert said.sum() == voxels[-1]
    assert not true[-1]
    text = markdown(found)
    assert text.count("\n| network | ") == 1
    assert "| load number: highest third |" in text


def test_a_network_that_does_not_deform_is_no_contender(sets: tuple[DeformationSet, DeformationSet]) -> None:
    with pytest.raises(TypeError, match="ReconstructionNetwork deforms nothing"):
        contenders(tiny.reconstruction_network(), 0.5, sets[0], [])


def test_the_command_writes_both_reports(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    from training.__main__ import main

    data = tiny.write_deformations(tmp_path / "data")
    tiny.save_checkpoint(tiny.deformation_network(), tiny.FIT_DEFORMATION, tmp_path / "run")
    arguments = ["compare", "--run", str(tmp_path / "run"), "--data", str(data), "--out", str(tmp_path / "out")]
    assert main([*arguments, "--samples", "2", "--cells", "8"]) == 0
    assert (tmp_path / "out" / "comparison.md").read_text() in capsys.readouterr().out
    for picture in ("curves.svg", "frontier.svg"):
        assert b"<svg" in (tmp_path / "out" / picture).read_bytes()
    sheet = cv2.imread(str(tmp_path / "out" / "worst.png"))
    assert sheet.shape == (2 * TILE, 2 * TILE, 3)  # two samples, true and given
    assert (sheet < 250).any(axis=2).mean() > 0.05
    assert main(["compare", "--run", str(tmp_path), "--data", str(data), "--out", str(tmp_path / "no")]) == 1
    assert not (tmp_path / "no").exists()
