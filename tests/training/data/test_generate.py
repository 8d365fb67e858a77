import errno
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.training.data import draws
from training.data.generate import THREAD_VARIABLES, draw_one, fill, write_one
from training.data.store import Store, StoreError

GROUPS = range(40)


@pytest.fixture(autouse=True)
def _threads_restored(monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in THREAD_VARIABLES:
        monkeypatch.setenv(variable, "1")


@pytest.fixture(scope="module")
def digest(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Of the set as one worker draws it without a break."""
    manifest = fill(Store(tmp_path_factory.mktemp("whole")), draws.quick, GROUPS, 1, {})
    assert manifest["dropped"] == {"empty": 4, "thin": 4}
    assert manifest["groups"] == 32
    return str(manifest["digest"])


def test_two_workers_draw_the_same_set_as_one(tmp_path: Path, digest: str) -> None:
    assert fill(Store(tmp_path), draws.quick, GROUPS, 2, {})["digest"] == digest


def test_a_killed_generation_resumes_to_the_same_set(tmp_path: Path, digest: str) -> None:
    store = Store(tmp_path)
    script = (
        "from pathlib import Path; from tests.training.data import draws; "
        "from training.data.generate import fill; from training.data.store import Store; "
        f"fill(Store(Path({str(tmp_path)!r})), draws.slow, range({len(GROUPS)}), 2, {{}})"
    )
    # A session of its own, so that the kill takes the workers too, as the end of a container does.
    process = subprocess.Popen(
        [sys.executable, "-c", script], cwd=ROOT, start_new_session=True, stderr=subprocess.DEVNULL
    )
    try:
        deadline = time.monotonic() + 60
        while len(list((tmp_path / "groups").glob("*.npz"))) < 5:
            assert process.poll() is None, "the generation ended before it could be killed"
            assert time.monotonic() < deadline
            time.sleep(0.01)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert not (tmp_path / "manifest.json").exists()
    done = {index for index in GROUPS if store.is_done(index)}
    assert 5 <= len(done) < len(GROUPS)
    times = {index: store.group_path(index).stat().st_mtime_ns for index in done if store.group_path(index).exists()}
    assert fill(store, draws.quick, GROUPS, 1, {})["digest"] == digest
    assert all(store.group_path(index).stat().st_mtime_ns == was for index, was in times.items()), "drawn again"


def test_progress_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    fill(Store(tmp_path / "set"), draws.quick, range(2), 1, {})
    assert "[set] 2/2 groups  5 samples" in capsys.readouterr().err


def test_a_bug_in_a_draw_is_not_a_dropped_sample(tmp_path: Path) -> None:
    with pytest.raises(ZeroDivisionError, match="group 0"):
        fill(Store(tmp_path), draws.broken, range(1), 1, {})
    assert not Store(tmp_path).is_done(0)
    assert not (tmp_path / "manifest.json").exists()


def test_a_full_disk_stops_the_generation_at_once_and_it_goes_on_later(
    tmp_path: Path, digest: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    store = Store(tmp_path)
    for index in range(10):
        write_one(store, index, draw_one(draws.quick, index))
    # A folder where no file can be made fails as a full disk does, in every process.
    with monkeypatch.context() as patch:
        patch.setattr("training.data.store._FULL", (errno.ENOTDIR, errno.EEXIST))
        (tmp_path / "groups").rename(tmp_path / "kept")
        (tmp_path / "groups").touch()
        with pytest.raises(StoreError, match="no space left"):
            write_one(store, 10, draw_one(draws.quick, 10))
    (tmp_path / "groups").unlink()
    (tmp_path / "kept").rename(tmp_path / "groups")
    assert fill(store, draws.quick, GROUPS, 1, {})["digest"] == digest


def test_another_configuration_is_refused_before_anything_is_drawn(tmp_path: Path) -> None:
    fill(Store(tmp_path), draws.quick, range(1), 1, {"seed": 1})
    with pytest.raises(StoreError, match="seed differ"):
        fill(Store(tmp_path), draws.broken, range(2), 1, {"seed": 2})
