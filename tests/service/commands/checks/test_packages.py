"""Requirements against what is installed."""

from __future__ import annotations

from importlib import metadata

from service.commands.checks.packages import check_packages


def states(*requirements: str) -> dict[str, str]:
    return {check.name: check.state for check in check_packages(requirements)}


def test_what_is_there_and_new_enough():
    assert states("numpy>=1.26", "httptools>=0.6; sys_platform != 'win32'")["packages"] == "ok"


def test_what_is_missing_or_old_says_what_to_install():
    found = {check.name: check for check in check_packages(["numpy>=99.1", "no-such-thing>=1"])}
    assert found["numpy"].state == "fail"
    assert found["numpy"].found.startswith(metadata.version("numpy"))
    assert found["numpy"].mend == "pip install -U 'numpy>=99.1'"
    assert found["no-such-thing"].mend == "pip install 'no-such-thing>=1'"


def test_what_is_for_others_is_left_alone():
    assert "torch" not in states("torch==99; extra == 'training'", "pywin32>=1; sys_platform == 'win32'")
