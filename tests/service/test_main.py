"""The command line as a whole: with which code it ends, and what it says then."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import pytest

from service.__main__ import main, parser
from service.commands.exits import FAILED, INTERRUPTED, OK, USAGE
from tests.conftest import ROOT


def test_a_wrong_setting_names_its_variable(monkeypatch, capsys):
    monkeypatch.setenv("PHYSNET_QUEUE_SIZE", "many")
    assert main(["serve"]) == USAGE
    assert "PHYSNET_QUEUE_SIZE" in capsys.readouterr().err


def test_a_directory_without_models_is_a_failure(tmp_path, capsys):
    assert main(["models", "--models", str(tmp_path)]) == FAILED
    told = capsys.readouterr().err
    assert str(tmp_path) in told
    assert "physnet doctor" in told
    assert main(["serve", "--models", str(tmp_path), "--http-port", "0", "--grpc-port", "0"]) == FAILED


@pytest.mark.parametrize(
    ("given", "threads"),
    [({}, "1"), ({"OMP_NUM_THREADS": "3"}, "3"), ({"OMP_NUM_THREADS": "3", "OPENBLAS_NUM_THREADS": "2"}, "2")],
)
def test_numpy_finds_its_number_of_threads_when_it_is_loaded(given, threads):
    program = (
        "import os, sys\n"
        "found = []\n"
        "def hear(event, arguments):\n"
        "    if event == 'import' and arguments[0] == 'numpy':\n"
        "        found.append(os.environ.get('OPENBLAS_NUM_THREADS'))\n"
        "sys.addaudithook(hear)\n"
        "import service.__main__, numpy\n"
        "print(found[0])\n"
    )
    env = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")} | given
    command = [sys.executable, "-c", program]
    done = subprocess.run(command, env=env, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == [threads]


def test_no_command_is_wrong_usage(capsys):
    assert main([]) == USAGE
    told = capsys.readouterr().err
    assert "\n  materials   list the named materials\n" in told, "each command has its line beside it"


def test_the_version(capsys):
    with pytest.raises(SystemExit) as caught:
        main(["--version"])
    assert caught.value.code == OK
    assert capsys.readouterr().out.startswith("physnet")


def test_every_command_tells_its_exit_codes(capsys):
    commands = ("serve", "predict", "replay", "bench", "materials", "models", "doctor", "completion")
    listing = parser().format_help()
    for command in commands:
        assert command in listing
        with pytest.raises(SystemExit) as caught:
            main([command, "--help"])
        assert caught.value.code == OK
        assert "exit codes: 0 done" in capsys.readouterr().out


@pytest.mark.parametrize(("error", "code"), [(KeyboardInterrupt(), INTERRUPTED), (BrokenPipeError(), OK)])
def test_what_is_no_error_of_ours(monkeypatch, error, code):
    def fail(words: str) -> None:
        raise error

    monkeypatch.setattr("service.commands.materials.search_materials", fail)
    assert main(["materials"]) == code


def test_models_are_listed_for_people_and_programs(models_directory, capsys):
    assert main(["models", "--models", str(models_directory), "--threads", "1"]) == OK
    told = capsys.readouterr().out
    assert "reconstruction" in told
    assert "with the digests of the manifest" in told
    assert re.search(r"measured   IoU 0\.\d{3}.* on [\d,]+ samples", told)
    assert "\x1b[" not in told
    assert main(["models", "--models", str(models_directory), "--threads", "1", "--json"]) == OK
    manifests = json.loads(capsys.readouterr().out)["models"]
    assert {manifest["kind"] for manifest in manifests} == {"reconstruction", "deformation"}
