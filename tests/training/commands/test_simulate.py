"""`physnet-train simulate`, in-process."""

from pathlib import Path

import pytest

from tests.training import tiny
from training.__main__ import main
from training.data.catalogue import SETS
from training.data.generate import THREAD_VARIABLES
from training.data.store import Store


@pytest.fixture(autouse=True)
def _threads_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in THREAD_VARIABLES:
        monkeypatch.setenv(variable, "1")


def test_every_set_is_listed_with_its_size(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["simulate", "--help"])
    assert ended.value.code == 0
    help_text = capsys.readouterr().out
    for name, data_set in SETS.items():
        assert f"  {name:15} {data_set.groups:5} groups" in help_text


def test_a_fraction_of_a_set_is_drawn_and_more_of_it_added(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """400 groups in all; what is there is not drawn again."""
    store = Store(tmp_path / "set")
    command = ["simulate", "bridge-20x20", "--out", str(store.root), "--workers", "1"]
    assert main([*command, "--fraction", "0.005"]) == 0
    assert "2 samples in 2 groups, dropped {}" in capsys.readouterr().err
    written = store.group_path(0).stat().st_mtime_ns
    assert main([*command, "--groups", "3", "--resume"]) == 0
    assert store.manifest()["groups"] == 3
    assert store.group_path(0).stat().st_mtime_ns == written
    assert store.manifest()["configuration"]["set"] == "bridge-20x20"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["stretch", "--fraction", "0"], "in (0, 1]"),
        (["stretch", "--fraction", "1.5"], "in (0, 1]"),
        (["stretch", "--groups", "513"], "stretch has 512 groups in all"),
        (["everyday", "--groups", "0"], "at least 1"),
        (["everyday", "--workers", "0"], "at least 1"),
        (["everyday", "--loads", "0"], "at least 1"),
        (["views", "--loads", "2"], "drawn pushes"),
    ],
)
def test_sizes_that_make_no_sense_are_refused(
    arguments: list[str], message: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", *arguments, "--out", str(tmp_path / "set")]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "set").exists()


def test_a_folder_that_holds_another_set_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    store = Store(tmp_path)
    store.begin(SETS["everyday"].with_seed(1).configuration("everyday", 1))
    store.write_group(0, tiny.deformation_group(0))
    assert main(["simulate", "everyday", "--seed", "2", "--groups", "1", "--out", str(tmp_path)]) == 1
    assert "drawn otherwise (seed differ)" in capsys.readouterr().err
    assert not store.manifest_path.exists()
