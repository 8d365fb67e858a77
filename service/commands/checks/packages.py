"""Versions of what PhysNet stands on, against what it asks for."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from importlib import metadata

from service.commands.checks.check import Check

OPTIONAL = {"matplotlib": "pictures"}
"""Not needed to serve, and what installs them: `physnet[…]`."""


def check_packages(requirements: Sequence[str] | None = None) -> Iterator[Check]:
    """Each requirement of the base install: there, and new enough.

    Args:
        requirements: Such as `numpy>=1.26`; those of the installed distribution if not given.
    """
    if requirements is None:
        try:
            requirements = metadata.requires("physnet") or ()
        except metadata.PackageNotFoundError:
            mend = "run from an installed package to have versions checked: pip install -e ."
            yield Check("packages", "warn", "physnet itself is not installed", mend)
            return
    told = []
    for requirement in requirements:
        specification, _, marker = requirement.partition(";")
        if "extra" in marker or ("win32" in marker and "!=" not in marker):
            continue
        found = re.match(r"([\w.-]+)(?:\[[^]]*])?\s*(.*)", specification.strip())
        assert found, requirement
        name, wanted = found[1], found[2]
        try:
            version = metadata.version(name)
        except metadata.PackageNotFoundError:
            yield Check(name, "fail", "not installed", f"pip install '{specification.strip()}'")
            continue
        if not _is_new_enough(version, wanted):
            yield Check(name, "fail", f"{version}, needs {wanted}", f"pip install -U '{specification.strip()}'")
            continue
        told.append(f"{name} {version}")
    shown = [text for text in told if text.split()[0] in ("numpy", "onnxruntime", "opencv-python-headless", "grpcio")]
    yield Check("packages", "ok", f"{len(told)} as required, among them {', '.join(shown)}")
    for name, extra in OPTIONAL.items():
        try:
            metadata.version(name)
        except metadata.PackageNotFoundError:
            yield Check(name, "warn", "not installed", f"only where it is wanted: pip install 'physnet[{extra}]'")


def _is_new_enough(version: str, wanted: str) -> bool:
    """Whether a version meets its lower bounds; other bounds are pip's affair."""
    bounds = re.findall(r">=\s*([\d.]+)", wanted)
    return all(_key(version) >= _key(bound) for bound in bounds)


def _key(version: str) -> tuple[int, ...]:
    return tuple(int(part) for part in re.findall(r"\d+", version.split("+")[0])[:3])
