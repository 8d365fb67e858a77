"""The shipped playground is what web/ builds to."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path

import pytest

from tests.conftest import ROOT

WEB = ROOT / "web"
SHIPPED = ROOT / "service" / "web"


def source_files(folder: Path) -> list[Path]:
    """As web/vite.config.ts counts them."""
    found = []
    for entry in folder.iterdir():
        if entry.name == "node_modules" or entry.name.startswith("."):
            continue
        found += source_files(entry) if entry.is_dir() else [entry]
    return found


def test_the_build_is_not_older_than_its_sources():
    if not WEB.is_dir():
        pytest.skip("web/ is not here: this is an installed package, not a checkout")
    digest = hashlib.sha256()
    named = {path.relative_to(WEB).as_posix(): path for path in source_files(WEB)}
    for name in sorted(named):
        digest.update(name.encode() + b"\0" + named[name].read_bytes() + b"\0")
    made = json.loads((SHIPPED / "build.json").read_text("utf-8"))
    assert made["sources_sha256"] == digest.hexdigest(), "web/ has changed since `make web`"


def test_the_samples_are_those_of_the_examples():
    samples = sorted(path.parent.name for path in (SHIPPED / "samples").glob("*/depth.png"))
    assert samples == ["bowl", "mug", "sugar_box"]
    for name in samples:
        for file in ("depth.png", "intrinsics.json"):
            original = ROOT / "examples" / "frames" / name / file
            assert (SHIPPED / "samples" / name / file).read_bytes() == original.read_bytes()


def test_nothing_is_loaded_from_elsewhere():
    """Robots have no internet. Addresses in the code are names of XML, messages of three.js and licences."""
    page = (SHIPPED / "index.html").read_text("utf-8")
    assert re.findall(r'(?:src|href)="(https?:)?//', page) == []
    style = "".join(path.read_text("utf-8") for path in (SHIPPED / "assets").glob("*.css"))
    assert "url(" not in style
    assert "@import" not in style


def test_every_asset_the_page_names_is_there_and_no_other_script():
    page = (SHIPPED / "index.html").read_text("utf-8")
    named = set(re.findall(r'"/web/(assets/[^"]+)"', page))
    there = {f"assets/{path.name}" for path in (SHIPPED / "assets").iterdir() if path.suffix in {".js", ".css"}}
    assert named == there
