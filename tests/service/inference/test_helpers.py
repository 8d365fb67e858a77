import os
import threading
from collections.abc import Iterator
from pathlib import Path

import onnxruntime
import pytest

from service.inference import helpers
from service.inference.artefacts import read_manifest
from service.inference.helpers import Helpers, starting
from service.inference.session import open_sessions
from service.inference.spare_cores import SpareCores

linux = pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="threads have no cores of their own here")


@pytest.fixture
def helper() -> Iterator[int]:
    """A thread that waits."""
    go_on = threading.Event()
    thread = threading.Thread(target=go_on.wait, args=(30.0,))
    thread.start()
    assert thread.native_id is not None
    yield thread.native_id
    go_on.set()
    thread.join()


@linux
def test_a_librarys_threads_are_found_by_the_name_they_were_started_with(model_folders: dict[str, Path]) -> None:
    folder = model_folders["reconstruction"]
    own_name, before = Path("/proc/thread-self/comm").read_text(), Helpers().ids
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 2
    others = onnxruntime.InferenceSession(str(folder / "model.onnx"), options)
    (session,) = open_sessions(folder, read_manifest(folder), threads=[3])
    assert len(Helpers().ids - before) == 2
    assert Path("/proc/thread-self/comm").read_text() == own_name
    del others, session
    assert Helpers().ids <= before


@linux
def test_helpers_run_where_the_calling_thread_does_not(helper: int, monkeypatch: pytest.MonkeyPatch) -> None:
    cores = os.sched_getaffinity(0)
    if len(cores) < 2:
        pytest.skip("has one core")
    here, elsewhere, *_ = sorted(cores)
    found = Helpers([helper])
    for core in (here, elsewhere):
        monkeypatch.setattr(helpers, "_sched_getcpu", lambda core=core: core)
        found.keep_off()
        assert os.sched_getaffinity(helper) == cores - {core}
    assert os.sched_getaffinity(0) == cores


@linux
def test_the_core_is_the_one_that_the_thread_runs_on() -> None:
    cores = os.sched_getaffinity(0)
    try:
        for core in cores:
            os.sched_setaffinity(0, {core})
            assert helpers._core() == core
    finally:
        os.sched_setaffinity(0, cores)


@linux
def test_helpers_that_have_ended_and_threads_of_one_core_are_left_alone(helper: int) -> None:
    cores = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(cores)})
        Helpers([helper]).keep_off()
        assert os.sched_getaffinity(helper) == cores
    finally:
        os.sched_setaffinity(0, cores)
    gone = threading.Thread(target=int)
    gone.start()
    gone.join()
    assert gone.native_id is not None
    Helpers([gone.native_id]).keep_off()


def test_where_the_system_does_not_tell_nothing_is_done(helper: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(helpers, "_sched_getcpu", None)
    monkeypatch.setattr(helpers, "_TASKS", Path("/nonexistent"))
    monkeypatch.setattr(helpers, "_OWN_NAME", Path("/nonexistent/comm"))
    with starting():
        Helpers([helper]).keep_off()


@linux
def test_a_request_keeps_them_off_its_core(monkeypatch: pytest.MonkeyPatch) -> None:
    cores = os.sched_getaffinity(0)
    if len(cores) < 2:
        pytest.skip("has one core")
    spare = SpareCores(1)
    (thread,) = [thread for thread in threading.enumerate() if thread.native_id in spare._helpers.ids]
    assert thread.native_id is not None
    monkeypatch.setattr(helpers, "_sched_getcpu", lambda: min(cores))
    with spare.answering():
        assert os.sched_getaffinity(thread.native_id) == cores - {min(cores)}
    monkeypatch.setattr(helpers, "_sched_getcpu", lambda: max(cores))
    with spare.answering(), spare.answering():  # the second leaves them where they are
        assert os.sched_getaffinity(thread.native_id) == cores - {max(cores)}
