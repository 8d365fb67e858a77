"""A local Ray cluster of two workers, in a process of its own: Ray keeps threads and sockets that outlive a test."""

import json
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from tests.conftest import ROOT
from tests.training.data import draws
from training.data.generate import draw_one, write_one
from training.data.store import Store, StoreError

GROUPS = 40

SCRIPT = """
import functools, json, sys
from pathlib import Path
from tests.training.data import draws
from training.data.generate import fill
from training.data.store import Store
folder = sys.argv[1]
draw = functools.partial(draws.mortal, folder)
print(json.dumps(fill(Store(Path(folder) / "set"), draw, range({groups}), 2, {{}}, engine="ray")))
"""


@pytest.mark.slow
@pytest.mark.skipif(" " in sys.executable, reason="Ray starts its workers through a shell: no spaces in Python's path")
@pytest.mark.skipif(find_spec("ray") is None, reason="Ray is not installed: pip install 'physnet[cluster]'")
def test_a_cluster_that_loses_a_worker_half_way_draws_the_same_set(tmp_path: Path) -> None:
    alone = Store(tmp_path / "alone")
    for index in range(GROUPS):
        write_one(alone, index, draw_one(draws.quick, index))
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT.format(groups=GROUPS), str(tmp_path)],
        cwd=ROOT, capture_output=True, text=True, timeout=150,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr[-3000:]
    assert (tmp_path / "died").exists(), "no worker was killed"
    manifest = json.loads(done.stdout.splitlines()[-1])
    assert manifest["digest"] == alone.write_manifest({})["digest"]
    assert manifest["dropped"] == {"empty": 4, "thin": 4}


def test_a_missing_ray_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from training.data.cluster import draw_on_cluster

    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(StoreError, match="pip install"):
        next(iter(draw_on_cluster(draw_one, draws.quick, [0], 1)))
