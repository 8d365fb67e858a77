from pathlib import Path

import numpy as np
import pytest

from service.core.grids import unpack_bits
from training.__main__ import main
from training.data.batches import ViewSet
from training.data.recgan import RecGanViews, read_grid
from training.data.store import Store, StoreError


def write_grid(folder: Path, view: str, size: tuple[int, int, int], voxels: list[tuple[int, int, int]]) -> Path:
    folder.mkdir(exist_ok=True)
    path = folder / f"{view}_{size[0]}_{size[1]}_{size[2]}.txt"
    np.savetxt(path, np.array(voxels).reshape(-1, 3))  # in floats, as theirs are
    return path


def test_a_small_grid_lies_in_the_middle(tmp_path: Path) -> None:
    grid = read_grid(write_grid(tmp_path, "chair", (3, 64, 10), [(0, 0, 0), (2, 63, 9)]))
    # (64 − 3)/2 and (64 − 10)/2, rounded down
    assert np.argwhere(grid).tolist() == [[30, 0, 27], [32, 63, 36]]


def test_a_large_grid_loses_what_lies_around_its_middle(tmp_path: Path) -> None:
    grid = read_grid(write_grid(tmp_path, "chair", (70, 64, 64), [(2, 0, 0), (3, 1, 1), (66, 2, 2), (67, 3, 3)]))
    assert np.argwhere(grid).tolist() == [[0, 1, 1], [63, 2, 2]]


def pairs(tmp_path: Path) -> tuple[Path, Path]:
    seen, full = tmp_path / "train_25d", tmp_path / "train_3d"
    for turn, name in enumerate(["a1_0_0_0", "a1_0_0_3", "b2_4_0_0"]):
        write_grid(seen, name, (20, 30, 40), [(turn, 0, 0)])
        write_grid(full, name, (22, 30, 40), [(turn, 0, 0), (21, 29, 39)])
    return seen, full


def test_the_rotations_of_an_object_are_one_group_and_training_reads_it(tmp_path: Path) -> None:
    seen, full = pairs(tmp_path)
    out = tmp_path / "set"
    assert main(["dataset", "import-recgan", str(seen), str(full), "--out", str(out)]) == 0
    groups = dict(Store(out).groups())
    assert {str(group["family"]): len(group["sample"]) for group in groups.values()} == {"a1": 2, "b2": 1}
    assert np.argwhere(unpack_bits(groups[0]["observed"][1])).tolist() == [[23, 17, 12]]
    assert unpack_bits(groups[0]["truth"][1]).sum() == 2
    assert not groups[0]["free"].any()
    assert len(ViewSet.load(out, "all")) == 3


def test_one_full_shape_may_serve_all_rotations(tmp_path: Path) -> None:
    seen, full = tmp_path / "seen", tmp_path / "full"
    first = write_grid(seen, "a1_0_0_0", (4, 4, 4), [(0, 0, 0)])
    whole = write_grid(full, "a1", (4, 4, 4), [(0, 0, 0)])
    assert RecGanViews.find(seen, full).objects == {"a1": [(first, whole)]}


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        pytest.param("chair.txt", "0 0 0", "says no size", id="no size"),
        pytest.param("chair_4_4_4.txt", "0 0 4", "within", id="outside"),
        pytest.param("chair_4_4_4.txt", "", "0 voxels", id="empty"),
        pytest.param("chair_4_4_4.txt", "0 0", "three numbers", id="two numbers"),
        pytest.param("chair_4_4_4.txt", "a b c", "three numbers", id="words"),
    ],
)
def test_what_is_no_grid_is_refused(tmp_path: Path, name: str, text: str, message: str) -> None:
    path = tmp_path / name
    path.write_text(text)
    with pytest.raises(StoreError, match=message):
        read_grid(path)


def test_a_view_without_its_shape_and_a_folder_without_grids_are_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    seen, full = pairs(tmp_path)
    next(full.glob("b2*")).unlink()
    assert main(["dataset", "import-recgan", str(seen), str(full), "--out", str(tmp_path / "set")]) == 1
    assert "no full shape of b2_4_0_0" in capsys.readouterr().err
    assert main(["dataset", "import-recgan", str(tmp_path), str(full), "--out", str(tmp_path / "set")]) == 1
    assert "holds no grid" in capsys.readouterr().err
