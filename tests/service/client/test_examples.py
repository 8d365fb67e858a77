"""What people copy runs: the README's ten lines against a real service, the examples against one without networks."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Iterator

import pytest

from tests.conftest import ROOT, LiveService
from tests.service.fakes import FakePredictor, Running, running


def test_the_ten_lines_of_the_readme_do_a_real_call(live_service: LiveService, tmp_path, monkeypatch, capsys):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text("utf-8"), re.S)
    (lines,) = [block for block in blocks if "service.client" in block]
    assert len([line for line in lines.splitlines() if line.strip()]) <= 10
    (url,) = re.findall(r'"(grpc://[^"]+)"', lines)
    code = lines.replace(url, f"grpc://{live_service.grpc}").replace("examples/", f"{ROOT}/examples/")
    monkeypatch.chdir(tmp_path)
    exec(compile(code, "README.md", "exec"), {})
    displacement_m, points = capsys.readouterr().out.split(maxsplit=1)
    assert 0.0 < float(displacement_m) < 0.2
    assert re.match(r"\(\d+, 3\)", points)
    assert [path.suffix for path in tmp_path.iterdir()] == [".glb"]


def test_the_page_on_the_client_runs(live_service: LiveService, tmp_path, monkeypatch, capsys):
    """All but the stream's, which is about a camera that there is not."""
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "client.md").read_text("utf-8"), re.S)
    blocks = [block for block in blocks if "on_frame" not in block]
    assert len(blocks) == 3
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for block in blocks:
        code = block.replace("grpc://127.0.0.1:8001", f"grpc://{live_service.grpc}")
        exec(compile(code.replace("examples/", f"{ROOT}/examples/"), "client.md", "exec"), names)
    said = capsys.readouterr().out
    assert re.search(r"loads\[1\]\.contact_m: 0\.\d{3} m beside the body", said), said
    assert (tmp_path / "after.ply").stat().st_size > 10_000


@pytest.fixture(scope="module")
def service() -> Iterator[Running]:
    with running(FakePredictor()) as service:
        yield service


@pytest.mark.parametrize(
    ("name", "options", "says"),
    [
        ("client_plan.py", ["--force", "5"], r"chosen: 330°, 36\.0 mm"),
        ("client_plan.py", ["--limit-mm", "10"], r"chosen: 60°, 9\.0 mm"),
        ("client_stream.py", ["--seconds", "0.5"], r"[1-9]\d* answered, \d+ overtaken, 0 failed\nfrom frame"),
    ],
)
def test_an_example_runs(service, name, options, says):
    command = [sys.executable, str(ROOT / "examples" / name), "--url", f"grpc://{service.grpc}", *options]
    # As where the package is installed, also when it is not.
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, env=environment)
    assert done.returncode == 0, done.stderr
    assert re.search(says, done.stdout), done.stdout
