"""Every flag of `physnet serve` is a setting, and each setting that operators read about is one."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from service.__main__ import main
from service.commands.exits import OK
from service.settings import Settings

ROOT = Path(__file__).resolve().parents[3]


def test_every_flag_becomes_its_setting(monkeypatch):
    seen: list[Settings] = []
    monkeypatch.setattr("service.app.run", lambda settings: seen.append(settings) or OK)
    flags = {
        "host": "0.0.0.0", "http_port": 1, "grpc_port": 2, "threads": 3, "log_level": "debug", "log_format": "json",
        "reconstruction_bytes": 1000, "reconstruction_lifetime_s": 2.5, "tracing_endpoint": "http://127.0.0.1:4317",
    }  # fmt: skip
    words = [word for name, value in flags.items() for word in (f"--{name.replace('_', '-')}", str(value))]
    assert main(["serve", *words]) == OK
    assert {name: getattr(seen[0], name) for name in flags} == flags


def test_help_names_the_variable_of_every_flag(capsys):
    with pytest.raises(SystemExit):
        main(["serve", "--help"])
    text = capsys.readouterr().out
    named = set(re.findall(r"PHYSNET_([A-Z_]+)", text))
    assert {"HTTP_PORT", "RECONSTRUCTION_BYTES", "RECONSTRUCTION_LIFETIME_S", "LOG_FORMAT", "TRACING_ENDPOINT"} <= named
    assert {name.lower() for name in named} <= set(Settings.model_fields)


def test_the_page_for_operators_has_every_setting_and_no_other():
    page = (ROOT / "docs" / "operations.md").read_text("utf-8")
    assert {name.lower() for name in re.findall(r"`PHYSNET_([A-Z_]+)`", page)} == set(Settings.model_fields)
