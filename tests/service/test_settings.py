"""Settings from the environment, and the cores a container really has."""

from __future__ import annotations

import os

import pytest
from pydantic import ValidationError

from service import settings as module
from service.settings import Settings, available_cores


@pytest.fixture(autouse=True)
def no_settings_of_whoever_runs_the_tests(monkeypatch):
    for name in [name for name in os.environ if name.startswith("PHYSNET_")]:
        monkeypatch.delenv(name)


def test_the_environment_sets_every_field(monkeypatch, tmp_path):
    chosen = {"HOST": "0.0.0.0", "HTTP_PORT": "0", "MODELS": str(tmp_path), "QUEUE_SIZE": "3", "TOKEN": "s3cret"}
    for name, value in chosen.items():
        monkeypatch.setenv(f"PHYSNET_{name}", value)
    settings = Settings()
    assert (settings.host, settings.http_port, settings.models, settings.queue_size) == ("0.0.0.0", 0, tmp_path, 3)
    assert settings.token.get_secret_value() == "s3cret"
    # A setting printed into a log must not carry the token along.
    assert "s3cret" not in repr(settings)


def test_arguments_win_over_the_environment(monkeypatch):
    monkeypatch.setenv("PHYSNET_HTTP_PORT", "9000")
    assert Settings(http_port=1234).http_port == 1234


@pytest.mark.parametrize(
    ("name", "value"),
    [("HTTP_PORT", "70000"), ("QUEUE_SIZE", "0"), ("THREADS", "-1"), ("LOG_LEVEL", "loud"),
     ("LOG_FORMAT", "xml"), ("RECONSTRUCTION_BYTES", "-1"), ("RECONSTRUCTION_LIFETIME_S", "0"), ("TRACING_SHARE", "2")],
)
def test_a_setting_out_of_its_range_is_refused(monkeypatch, name, value):
    monkeypatch.setenv(f"PHYSNET_{name}", value)
    with pytest.raises(ValidationError, match=name.lower()):
        Settings()


def test_settings_are_frozen():
    with pytest.raises(ValidationError, match="frozen"):
        Settings().host = "elsewhere"


def test_models_of_a_wheel_come_before_those_of_the_checkout(monkeypatch, tmp_path):
    monkeypatch.setattr(module, "_PACKAGE", tmp_path / "service")
    assert Settings().models == tmp_path / "models"
    (tmp_path / "service" / "_models").mkdir(parents=True)
    assert Settings().models == tmp_path / "service" / "_models"


@pytest.mark.parametrize(
    ("files", "cores"),
    [
        ({"cpu.max": "max 100000\n"}, 1e9),
        ({"cpu.max": "150000 100000\n"}, 1.5),
        ({"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, 1e9),
        ({"cpu/cpu.cfs_quota_us": "200000\n", "cpu/cpu.cfs_period_us": "100000\n"}, 2.0),
        ({}, 1e9),
    ],
)
def test_the_quota_of_the_cgroup(tmp_path, files, cores):
    for name, text in files.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    assert module._cgroup_cores(tmp_path) == cores


def test_threads_follow_affinity_and_quota(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(8)), raising=False)
    monkeypatch.setattr(module, "_cgroup_cores", lambda _: 1.5)
    # Half a core more is worth a second thread.
    assert available_cores() == 2
    monkeypatch.setattr(module, "_cgroup_cores", lambda _: 0.25)
    assert (available_cores(), Settings().threads) == (1, 1)
    monkeypatch.setattr(module, "_cgroup_cores", lambda _: 1e9)
    assert (available_cores(), Settings().threads) == (8, 2)
