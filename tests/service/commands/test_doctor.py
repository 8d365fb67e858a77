"""`physnet doctor`: what it finds, what it says to do, with which code it ends."""

from __future__ import annotations

import json

import pytest

from service import app
from service.__main__ import main
from service.app import Served
from service.commands.exits import FAILED, OK
from tests.service.fakes import FakePredictor, fake_manifest


@pytest.fixture
def quick(monkeypatch) -> None:
    """The models' digests are read, but a fake predicts."""
    monkeypatch.setattr(app, "build_pipeline", lambda settings: Served(FakePredictor(), [fake_manifest()]))


def test_a_machine_that_works(quick, models_directory, capsys):
    assert main(["doctor", "--json", "--models", str(models_directory)]) == OK
    document = json.loads(capsys.readouterr().out)
    assert document["ok"] is True
    states = {check["name"]: check["state"] for check in document["checks"]}
    for name in ("python", "processor", "cores", "memory", "model", "prediction", "timing"):
        assert states[name] in ("ok", "warn")
    assert all(check["mend"] for check in document["checks"] if check["state"] != "ok")


def test_no_models_are_a_failure_with_a_way_out(quick, tmp_path, capsys):
    assert main(["doctor", "--models", str(tmp_path)]) == FAILED
    told = capsys.readouterr().out
    assert "✗ models" in told
    assert "PHYSNET_MODELS" in told
    assert "1 of" in told.splitlines()[-1]


def test_a_setting_that_cannot_be_read_is_a_failure(monkeypatch, capsys):
    monkeypatch.setenv("PHYSNET_HTTP_PORT", "eighty")
    assert main(["doctor", "--json"]) == FAILED
    (wrong,) = [check for check in json.loads(capsys.readouterr().out)["checks"] if check["state"] == "fail"]
    assert "PHYSNET_HTTP_PORT" in wrong["found"]


def test_models_that_do_not_load_are_told(monkeypatch, models_directory, capsys):
    def explode(settings: object) -> Served:
        raise RuntimeError("no kernel for this graph")

    monkeypatch.setattr(app, "build_pipeline", explode)
    assert main(["doctor", "--models", str(models_directory)]) == FAILED
    assert "no kernel for this graph" in capsys.readouterr().out
