"""`physnet-train dataset`, in-process: what it prints, draws and returns."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.training import tiny
from training.__main__ import main
from training.data.contact_sheet import TILE
from training.data.store import Store


def test_inspect_prints_what_is_there_and_draws_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tiny.write_deformations(tmp_path / "boxes")
    Store(root).write_drop(6, "thin")
    Store(root).write_manifest({"set": "boxes", "groups": 7})
    assert main(["dataset", "inspect", str(root), "--samples", "5"]) == 0
    printed = capsys.readouterr().out
    overlap = np.concatenate([group["identity_iou"] for _, group in Store(root).groups()])
    for line in (
        "set                 boxes", "groups, samples     6, 12", "dropped             1 of 7: thin 1",
        "as in the manifest", "splits              train 3, test 2, validation 1", "families            box 6",
        f"identity IoU        median {np.median(overlap):.4g}",
    ):  # fmt: skip
        assert line in printed
    picture = cv2.imread(str(root / "contact-sheet.png"))
    assert picture.shape == (TILE + 150, 5 * TILE, 3)
    # Every tile shows a body.
    for tile in np.split(picture[30:TILE], 5, axis=1):
        assert (tile.min(axis=2) < 200).mean() > 0.02


def test_a_changed_set_is_told_from_its_manifest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tiny.write_deformations(tmp_path / "boxes")
    Store(root).write_group(3, tiny.deformation_group(4))
    assert main(["dataset", "inspect", str(root), "--samples", "1"]) == 1
    assert "DIFFERS from the manifest" in capsys.readouterr().out


def test_views_are_inspected_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    root = tiny.write_views(tmp_path / "views")
    target = tmp_path / "pictures" / "sheet.png"
    assert main(["dataset", "inspect", str(root), "--samples", "2", "--picture", str(target)]) == 0
    assert "observed voxels" in capsys.readouterr().out
    assert cv2.imread(str(target)).shape == (TILE, 2 * TILE, 3)


def test_an_unfinished_set_is_described_without_a_manifest(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Store(tmp_path).write_group(0, tiny.deformation_group(0))
    assert main(["dataset", "inspect", str(tmp_path), "--samples", "1"]) == 1
    assert "unfinished: no manifest" in capsys.readouterr().out


@pytest.mark.parametrize("verb", ["inspect", "import-2018"])
def test_what_is_not_there_is_named(verb: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["dataset", verb, str(tmp_path / "nothing")]
    arguments += ["--out", str(tmp_path / "out")] if verb == "import-2018" else []
    assert main(arguments) == 1
    assert str(tmp_path / "nothing") in capsys.readouterr().err
