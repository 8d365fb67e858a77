"""Puts the client's modules, and those of the core that it imports, into its distribution."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

# tests/service/client/test_distribution.py holds this list to what the client imports.
MODULES = (
    "service/__init__.py",
    "service/client",
    "service/api/__init__.py",
    "service/api/generated",
    "service/core/__init__.py",
    "service/core/archive.py",
    "service/core/arrays.py",
    "service/core/colours.py",
    "service/core/errors.py",
    "service/core/gltf.py",
    "service/core/grids.py",
    "service/core/hardness.py",
    "service/core/material_table.py",
    "service/core/materials.py",
    "service/core/surface_mesh.py",
)


class ClientModules(BuildHookInterface):
    """From the tree of the whole project, or from the source distribution, which has them beside this file."""

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        here = Path(self.root)
        tree = here if (here / "service").is_dir() else here.parents[1]
        for module in MODULES:
            build_data["force_include"][str(tree / module)] = module
