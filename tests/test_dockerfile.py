"""What can be known of the image without Docker: that what it copies is there, what it sets exists, its check works."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from service.settings import Settings
from tests.service.fakes import FakePredictor, running

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "Dockerfile").read_text("utf-8").replace("\\\n", " ")
INSTRUCTIONS = [line.split(None, 1) for line in TEXT.splitlines() if line.strip() and not line.lstrip().startswith("#")]
STAGES = [words[1] for words in INSTRUCTIONS if words[0] == "FROM"]
LAST = INSTRUCTIONS[max(index for index, words in enumerate(INSTRUCTIONS) if words[0] == "FROM") :]


def of(kind: str, instructions: list[list[str]]) -> list[str]:
    return [words[1] for words in instructions if words[0] == kind]


def test_what_is_built_and_what_is_run_are_two_stages():
    assert len(STAGES) == 2 and STAGES[0].endswith(" AS build")
    assert of("COPY", LAST) == ["--from=build /opt/physnet /opt/physnet"]


def test_what_is_copied_is_there_and_not_ignored():
    ignored = (ROOT / ".dockerignore").read_text("utf-8").split()
    sources = [source for line in of("COPY", INSTRUCTIONS) if "--from" not in line for source in line.split()[:-1]]
    assert {"pyproject.toml", "models", "service", "training"} <= set(sources)
    for source in sources:
        assert (ROOT / source).exists() and source not in ignored, source


def test_it_runs_as_nobody_in_particular():
    (created,) = [line for line in of("RUN", LAST) if "useradd" in line]
    (user,) = of("USER", LAST)
    assert created.split()[-1] == user != "root"
    assert int(re.search(r"--uid (\d+)", created)[1]) > 0
    # The command comes after: it is this user's.
    order = [words[0] for words in LAST]
    assert order.index("USER") < order.index("ENTRYPOINT") < order.index("CMD")


def test_every_variable_is_a_setting_with_a_value_it_takes(monkeypatch):
    for name in [name for name in os.environ if name.startswith("PHYSNET_")]:
        monkeypatch.delenv(name)
    (line,) = of("ENV", LAST)
    variables = dict(pair.split("=", 1) for pair in line.split())
    ours = {name: value for name, value in variables.items() if name.startswith("PHYSNET_")}
    assert {name.removeprefix("PHYSNET_").lower() for name in ours} <= set(Settings.model_fields)
    for name, value in ours.items():
        monkeypatch.setenv(name, value)
    settings = Settings()
    assert (settings.host, settings.log_format) == ("0.0.0.0", "json")
    assert of("EXPOSE", LAST) == [f"{settings.http_port} {settings.grpc_port}"]


def test_kernels_are_compiled_by_the_user_into_a_volume_of_its_own():
    order = [words[0] for words in LAST]
    (volume,) = of("VOLUME", LAST)
    (line,) = of("ENV", LAST)
    assert f"NUMBA_CACHE_DIR={volume}" in line.split()
    (owned,) = [i for i, words in enumerate(LAST) if words[1].startswith("install --directory") and volume in words[1]]
    filled = LAST.index(["RUN", '["physnet", "doctor"]'])
    # Written to after it is declared, a volume would lose what the image is to hold.
    assert owned < order.index("USER") < order.index("ENV") < filled < order.index("VOLUME")
    assert f"--owner={of('USER', LAST)[0]}" in LAST[owned][1].split()


@pytest.mark.parametrize("alive", [True, False])
def test_the_health_check_tells_the_living_from_the_dead(alive):
    (check,) = of("HEALTHCHECK", LAST)
    _, *arguments = json.loads(check[check.index("[") :])
    with running(FakePredictor()) as service:
        port = service.url.rsplit(":", 1)[1]
        if not alive:
            service.stop()
        done = subprocess.run(
            [sys.executable, *arguments], env={**os.environ, "PHYSNET_HTTP_PORT": port}, capture_output=True, timeout=60
        )
    assert (done.returncode == 0) == alive, done.stderr


def test_the_command_is_one_there_is():
    command = json.loads(of("ENTRYPOINT", LAST)[0]) + json.loads(of("CMD", LAST)[0])
    assert command == ["physnet", "serve"]
