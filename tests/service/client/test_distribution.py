"""The client's own distribution: it holds all that the client imports, and needs nothing that it does not declare."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from collections.abc import Iterator
from importlib.metadata import distribution, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from tests.conftest import ROOT
from tests.service.fakes import FakePredictor, running

HERE = ROOT / "clients" / "python"
PROJECT = tomllib.loads((HERE / "pyproject.toml").read_text("utf-8"))["project"]
MISSING = ("onnxruntime", "torch", "cv2", "fastapi", "uvicorn", "pydantic", "scipy", "grpc_status")


def needed(names: list[str]) -> set[str]:
    """Distributions and all that they need in turn, as installed here."""
    found: set[str] = set()
    while names:
        name = re.sub(r"[-_.]+", "-", names.pop()).lower()
        if name in found:
            continue
        found.add(name)
        for requirement in map(Requirement, requires(name) or ()):
            if requirement.marker is None or requirement.marker.evaluate({"extra": ""}):
                names.append(requirement.name)
    return found


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("dist")
    subprocess.run(
        [sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(out)], cwd=HERE, check=True,
        capture_output=True, timeout=120,
    )  # fmt: skip
    (built,) = out.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def robot(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Python of a fresh environment with this wheel, and of other distributions what it declares and no more."""
    folder = tmp_path_factory.mktemp("robot") / "venv"
    venv.create(folder, symlinks=True)
    site = Path(sysconfig.get_path("purelib", "venv", {"base": str(folder), "platbase": str(folder)}))
    with zipfile.ZipFile(wheel) as archive:
        archive.extractall(site)
    for name in needed([Requirement(text).name for text in PROJECT["dependencies"]]):
        # As pip would have put them there, but linked: what is tested is that nothing is missing.
        for file in distribution(name).files or ():
            link = site / file.parts[0]
            if ".." not in file.parts and file.parts[0] != "__pycache__" and not link.exists():
                link.symlink_to(distribution(name).locate_file(file.parts[0]))
    return folder / "bin" / "python"


def test_version_and_requirements_are_those_of_the_whole():
    whole = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    assert PROJECT["version"] == whole["version"]
    theirs = {Requirement(text).name: Requirement(text) for text in whole["dependencies"]}
    for requirement in map(Requirement, PROJECT["dependencies"]):
        if requirement.name in theirs:
            assert requirement.specifier == theirs[requirement.name].specifier, requirement.name


def imported(module: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(module.read_text("utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("service"):
            yield node.module
            yield from (f"{node.module}.{alias.name}" for alias in node.names)


def test_the_wheel_holds_what_the_client_imports_and_nothing_of_the_service(wheel):
    with zipfile.ZipFile(wheel) as archive:
        held = {name for name in archive.namelist() if name.startswith("service/") and name.endswith(".py")}
    wanted = {path.relative_to(ROOT).as_posix() for path in (ROOT / "service" / "client").rglob("*.py")}
    todo = list(wanted)
    while todo:
        path = ROOT / todo.pop()
        parents = [parent / "__init__.py" for parent in path.relative_to(ROOT).parents if parent.parts]
        modules = [] if "_pb2" in path.name else list(imported(path))
        for name in modules:
            parents += [Path(*name.split(".")).with_suffix(".py"), Path(*name.split(".")) / "__init__.py"]
        for found in parents:
            if (ROOT / found).exists() and found.as_posix() not in wanted:
                wanted.add(found.as_posix())
                todo.append(found.as_posix())
    assert held == wanted


CALL = """
import importlib.util, sys
import numpy as np
from service.client import Camera, PhysNetClient, Push
for name in {missing!r}:
    assert importlib.util.find_spec(name) is None, name + " is there"
depth_mm = np.full((48, 64), 600, np.uint16)
for url in sys.argv[1:]:
    with PhysNetClient(url) as client:
        result = client.deform(depth_mm, Camera(60, 60, 31.5, 23.5, 64, 48), Push((0, 0, 1), contact_px=(30, 20)))
        with client.stream() as stream:
            stream.send(depth_mm, Camera(60, 60, 31.5, 23.5, 64, 48), Push((0, 0, 1), contact_px=(30, 20)))
        assert [answer.unwrap().model for answer in stream] == [result.model]
    for suffix in ("npz", "ply", "glb", "bt", "binvox"):
        result.save("x." + suffix)
    print(result.model[0], result.mesh().faces.shape[1], result.displacement_at(result.points_camera()[:1]).shape)
"""


def test_it_calls_a_service_where_nothing_else_is_installed(robot, tmp_path):
    with running(FakePredictor()) as service:
        done = subprocess.run(
            [str(robot), "-I", "-c", CALL.format(missing=MISSING), service.url, f"grpc://{service.grpc}"],
            cwd=tmp_path, capture_output=True, text=True, timeout=120,
        )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["fake 3 (1, 3)"] * 2
