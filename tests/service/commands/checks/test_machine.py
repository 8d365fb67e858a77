"""What the doctor reads out of Linux."""

from __future__ import annotations

import os
import platform

import pytest

from service.commands.checks.machine import check_machine

CPUINFO = "model name\t: Test CPU @ 2.00GHz\nflags\t\t: fpu {} sse4_2\n"
MEMINFO = "MemTotal:       8388608 kB\nMemFree: 1 kB\nMemAvailable:   {} kB\n"


@pytest.fixture
def machine(tmp_path):
    """What is found on a machine of which some files are given."""

    def look(**files: str) -> dict[str, tuple[str, str, str]]:
        given = {"cpuinfo": CPUINFO.format("avx2"), "meminfo": MEMINFO.format(4_194_304), "loadavg": "0.00 0 0 1/2 3"}
        for name, text in (given | files).items():
            (tmp_path / name.replace("_max", ".max")).write_text(text)
        return {check.name: (check.state, check.found, check.mend) for check in check_machine(tmp_path, tmp_path)}

    return look


def test_a_good_machine(machine):
    found = machine()
    assert found["python"][0] == "ok"
    assert found["processor"] == ("ok", "Test CPU @ 2.00GHz (avx2)", "")
    assert found["load"][0] == "ok"
    assert found["memory"] == ("ok", "4,096 MiB free of 8,192 MiB", "")


@pytest.mark.skipif(platform.machine() != "x86_64", reason="AVX2 is of x86")
def test_a_processor_without_avx2_is_slow(machine):
    state, _, mend = machine(cpuinfo=CPUINFO.format("avx"))["processor"]
    assert state == "warn"
    assert "AVX2" in mend


def test_other_programs_spoil_the_timing(machine):
    state, found, _ = machine(loadavg=f"{2.0 * (os.cpu_count() or 1):.2f} 0 0 1/2 3")["load"]
    assert state == "warn"
    assert "cores" in found


def test_too_little_memory(machine):
    assert machine(meminfo=MEMINFO.format(100_000))["memory"][0] == "fail"
    # A container may hold less than the machine has.
    state, found, _ = machine(memory_max="104857600")["memory"]
    assert (state, found) == ("fail", "100 MiB free of 100 MiB")


def test_a_system_without_these_files(tmp_path):
    found = {check.name: check.state for check in check_machine(tmp_path / "no", tmp_path / "no")}
    assert found["memory"] == "warn"
    assert "fail" not in found.values()
