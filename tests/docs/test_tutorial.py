"""The tutorial's code blocks, run one after the other as they stand there, against the shipped models."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import ROOT, LiveService

BLOCK = re.compile(r"^(<!-- not run: [^>]+ -->\n)?```(sh|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)

BUSY = pytest.mark.timeout(600)
"""Several programs start; on a machine that has other things to do each may take a minute."""


def blocks(language: str, page: str = "tutorial.md") -> list[str]:
    """Code of a language that is meant to be run."""
    text = (ROOT / "docs" / page).read_text("utf-8")
    return [code for skipped, found, code in BLOCK.findall(text) if found == language and not skipped]


@pytest.fixture
def checkout(tmp_path: Path) -> tuple[Path, dict[str, str]]:
    """A folder that looks like a checkout, and an environment in which `physnet` is a command."""
    (tmp_path / "examples").symlink_to(ROOT / "examples")
    command = tmp_path / "bin/physnet"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m service "$@"\n')
    command.chmod(0o755)
    environment = {key: value for key, value in os.environ.items() if key != "PHYSNET_SHARED"}
    environment |= {"PATH": f"{command.parent}:{os.environ['PATH']}", "PYTHONPATH": str(ROOT)}
    return tmp_path, environment


def run(command: list[str], code: str, checkout: tuple[Path, dict[str, str]]) -> str:
    folder, environment = checkout
    done = subprocess.run(
        command, input=code, cwd=folder, env=environment, capture_output=True, text=True, timeout=500, check=False
    )
    assert done.returncode == 0, f"{code}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@BUSY
def test_the_commands_of_the_tutorial_do_what_it_says(checkout):
    pytest.importorskip("matplotlib")
    commands = "\n".join(blocks("sh"))
    assert commands.count("physnet ") >= 4
    told = run(["sh", "-e"], commands, checkout)
    assert re.search(r"all \d+ checks passed", told)
    assert "largest displacement" in told
    assert "ecoflex_00_30" in told
    assert "Shore A 20: Young's modulus about 732 kPa" in told
    folder, _ = checkout
    assert (folder / "mug.png").read_bytes().startswith(b"\x89PNG")
    assert (folder / "mug.glb").read_bytes().startswith(b"glTF")
    assert (folder / "mug.npz").stat().st_size > 10_000


@BUSY
def test_the_robot_of_the_tutorial_gets_its_answers(checkout, live_service: LiveService):
    code = "\n".join(blocks("python"))
    assert "grpc://127.0.0.1:8001" in code
    told = run([sys.executable, "-"], code.replace("127.0.0.1:8001", live_service.grpc), checkout)
    moved_mm = [float(number) for number in re.findall(r"\d+ N: +([\d.]+) mm", told)]
    assert len(moved_mm) == 4
    # The harder the push, the farther it goes.
    assert moved_mm == sorted(moved_mm)
    assert moved_mm[0] > 0
    folder, _ = checkout
    assert (folder / "mug_pushed.ply").stat().st_size > 10_000


def test_commands_to_retrain_are_commands_that_there_are():
    """What they do is tested in tests/training/data/test_meshes.py; here, that the page spells them right."""
    pytest.importorskip("scipy")  # the commands say what data sets there are, which are drawn with it
    training = pytest.importorskip("training.__main__", exc_type=ImportError)
    (text,) = blocks("sh", "retrain.md")
    lines = [line.split() for line in text.splitlines() if line]
    assert [line[:2] for line in lines] == [["physnet-train", name] for name in ("simulate", "fit", "export")]
    for _, command, *arguments in lines:
        with pytest.raises(SystemExit) as ended:
            training.main([command, *arguments, "--help"])
        assert ended.value.code == 0
