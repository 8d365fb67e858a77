"""Who may import whom, where import-linter cannot see: imports by name, what a cheap import drags in, its own lists."""

from __future__ import annotations

import ast
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("torch", "onnxruntime", "fastapi", "grpc", "scipy", "matplotlib", "pydantic", "trimesh", "octomap", "training")
DYNAMIC_MODULES = ("importlib", "runpy", "imp", "pkgutil")
READS_FILES_ONLY = ("importlib.metadata", "importlib.resources")
DYNAMIC_CALLS = ("__import__", "exec", "eval", "import_module")


def _sources(package: str) -> list[Path]:
    return [path for path in sorted((ROOT / package).rglob("*.py")) if "_pb2" not in path.name]


def _dynamic_imports(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Line and text of whatever could import a module by its name and so hide it from import-linter."""
    for node in ast.walk(tree):
        match node:
            case ast.Import(names=names):
                imported = [alias.name for alias in names]
            case ast.ImportFrom(module=str(module), names=names, level=0):
                imported = [f"{module}.{alias.name}" for alias in names]
            case ast.Call(func=ast.Name(id=name) | ast.Attribute(attr=name)) if name in DYNAMIC_CALLS:
                # `model.eval()` and `re.compile` are methods; only the bare builtins and import_module count.
                if isinstance(node.func, ast.Name) or name in ("import_module", "__import__"):
                    yield node.lineno, name
                continue
            case _:
                continue
        for name in imported:
            if name.split(".")[0] in DYNAMIC_MODULES and not name.startswith(READS_FILES_ONLY):
                yield node.lineno, name


@pytest.mark.parametrize(
    "source",
    [
        "import importlib\nimportlib.import_module('torch')",
        "from importlib import import_module",
        "def f():\n    return __import__('torch')",
        "exec('import torch')",
        "import builtins\nbuiltins.__import__('torch')",
    ],
)
def test_every_way_to_import_by_name_is_recognised(source: str) -> None:
    assert list(_dynamic_imports(ast.parse(source)))


def test_the_service_imports_nothing_by_name() -> None:
    found = [
        f"{path.relative_to(ROOT)}:{line} {what}"
        for path in _sources("service")
        for line, what in _dynamic_imports(ast.parse(path.read_text("utf-8")))
    ]
    assert not found, "import-linter cannot follow these: " + ", ".join(found)


@pytest.mark.parametrize("module", ["service", "service.core"])
def test_importing_the_core_stays_cheap(module: str) -> None:
    core = [
        ".".join(path.relative_to(ROOT).with_suffix("").parts)
        for path in _sources("service/core")
        if path.name != "__init__.py"
    ]
    imports = ", ".join([module] if module == "service" else [module, *core])
    # Numba loads SciPy where it finds it; to us it is not there.
    loads = f"import sys; sys.modules['scipy'] = None; import {imports}"
    script = f"{loads}; print(*{{name.split('.')[0] for name in sys.modules}})"
    loaded = subprocess.run(
        [sys.executable, "-c", script],
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
    ).stdout.split()
    assert "numpy" in loaded or module == "service"
    assert not (set(HEAVY) - {"scipy"}) & set(loaded)


def _contract(name_part: str) -> dict[str, list[str]]:
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["importlinter"]["contracts"]
    (found,) = [contract for contract in contracts if name_part in contract["name"]]
    return found


def test_training_is_kept_from_every_module_of_the_service_but_its_core() -> None:
    modules = {
        f"service.{path.stem}"
        for path in (ROOT / "service").iterdir()
        if (path.suffix == ".py" or (path / "__init__.py").exists()) and path.stem not in ("__init__", "core")
    }
    missing = modules - set(_contract("Training shares the core")["forbidden_modules"])
    assert not missing, f"add to the contract in pyproject.toml: {sorted(missing)}"


def test_service_modules_outside_the_layers_are_known() -> None:
    """A module beside the layers could be a way around them: list it here with what it may know."""
    layers = {name.strip("() ") for layer in _contract("one way")["layers"] for name in layer.split("|")}
    beside = {
        path.stem
        for path in (ROOT / "service").iterdir()
        if (path.suffix == ".py" or (path / "__init__.py").exists()) and path.stem != "__init__"
    } - layers
    assert beside <= {
        "settings",  # values only, built by the composition root
        "client",  # what robots import: talks to the wire alone
        "picture",  # draws a result
    }
