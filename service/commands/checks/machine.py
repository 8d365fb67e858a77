"""Processor, cores, memory: what a prediction has to live on."""

from __future__ import annotations

import os
import platform
import re
import sys
from collections.abc import Iterator
from pathlib import Path

from service.commands.checks.check import Check
from service.settings import available_cores

OLDEST_PYTHON = (3, 11)

NEEDED_BYTES = 600.0 * 2**20
"""What the service is built to stay below."""

BUSY = 0.5
"""Load for each core above which timings say little about the machine."""


def check_machine(proc: Path = Path("/proc"), cgroup: Path = Path("/sys/fs/cgroup")) -> Iterator[Check]:
    """Python, processor, cores and memory; `proc` and `cgroup` are Linux's own."""
    version = platform.python_version()
    if sys.version_info < OLDEST_PYTHON:
        yield Check("python", "fail", version, f"install Python {'.'.join(map(str, OLDEST_PYTHON))} or newer")
    else:
        yield Check("python", "ok", f"{version} on {platform.system()} {platform.machine()}")
    yield _processor(_read(proc / "cpuinfo"))
    yield from _cores(_read(proc / "loadavg"))
    yield _memory(_read(proc / "meminfo"), _cgroup_limit(cgroup))


def _processor(cpuinfo: str) -> Check:
    found = re.search(r"^model name\s*:\s*(.+)$", cpuinfo, re.MULTILINE)
    name = found[1] if found else platform.processor() or platform.machine()
    listed = re.search(r"^(?:flags|Features)\s*:\s*(.+)$", cpuinfo, re.MULTILINE)
    flags = set(listed[1].split()) if listed else set()
    told = [flag for flag in ("avx2", "fma", "avx512f", "avx512_vnni", "amx_tile", "asimd") if flag in flags]
    listing = f"{name} ({', '.join(told) or 'no vector extensions known'})"
    if platform.machine() in ("x86_64", "AMD64") and flags and "avx2" not in flags:
        return Check("processor", "warn", listing, "without AVX2 a prediction takes several times as long")
    return Check("processor", "ok", listing)


def _cores(loadavg: str) -> Iterator[Check]:
    cores, machine = available_cores(), os.cpu_count() or 1
    held = "" if cores == machine else f" of {machine}: affinity or a container's quota hold the others"
    if cores == 1:
        yield Check("cores", "warn", f"1{held}", "two cores or more answer faster: docker run --cpus 2, or taskset")
    else:
        yield Check("cores", "ok", f"{cores}{held}")
    load = float(loadavg.split()[0]) if loadavg else 0.0
    if load > BUSY * machine:
        mend = "other programs take the processor; the timing below is slower than this machine can do"
        yield Check("load", "warn", f"{load:.1f} on {machine} cores", mend)
    else:
        yield Check("load", "ok", f"{load:.1f} on {machine} cores")


def _memory(meminfo: str, limit_bytes: float) -> Check:
    found = {name: 1024.0 * int(size) for name, size in re.findall(r"^(\w+):\s+(\d+) kB", meminfo, re.MULTILINE)}
    if not found:
        return Check("memory", "warn", "unknown on this system", f"the service takes up to {_mib(NEEDED_BYTES)}")
    free = min(found.get("MemAvailable", found["MemTotal"]), limit_bytes)
    told = f"{_mib(free)} free of {_mib(min(found['MemTotal'], limit_bytes))}"
    if free < NEEDED_BYTES:
        return Check("memory", "fail", told, f"the service takes up to {_mib(NEEDED_BYTES)}: end something else")
    return Check("memory", "ok", told)


def _cgroup_limit(root: Path) -> float:
    """Bytes that the container may take (cgroup v2, else v1); infinity where there is no limit."""
    for name in ("memory.max", "memory/memory.limit_in_bytes"):
        text = _read(root / name).strip()
        if text.isdigit():
            return float(text)
    return float("inf")


def _mib(size: float) -> str:
    return f"{size / 2**20:,.0f} MiB"


def _read(path: Path) -> str:
    try:
        return path.read_text("utf-8", "replace")
    except OSError:
        return ""
