"""The pages under docs/: complete where they promise to be, and written by what they describe."""

from __future__ import annotations

import importlib.util
import re
import sys
from types import ModuleType

import pytest

from service.api.status import meanings
from service.client.errors import ServiceUnreachable, UnexpectedReply
from service.core.materials import MATERIALS
from tests.conftest import ROOT

DOCS = ROOT / "docs"


@pytest.fixture(scope="module")
def reference() -> ModuleType:
    """The hook that writes pages, which MkDocs loads by its path."""
    path = DOCS / "hooks/reference.py"
    specification = importlib.util.spec_from_file_location("docs_reference", path)
    assert specification is not None and specification.loader is not None
    module = importlib.util.module_from_spec(specification)
    before = list(sys.path)
    specification.loader.exec_module(module)
    sys.path[:] = before
    return module


def flags_of_the_service() -> set[str]:
    """Every flag that the pipeline raises, read where it is raised."""
    lines = [
        line
        for name in ("service/pipeline.py", "service/core/segmentation.py")
        for line in (ROOT / name).read_text("utf-8").splitlines()
        if re.search(r"\bflags(\.add\(| = )", line)
    ]
    return {flag for line in lines for flag in re.findall(r'"([a-z]+(?:_[a-z]+)+)"', line)}


def first_cells(page: str) -> set[str]:
    """What stands in backquotes in the first column of a page's tables."""
    rows = [line.split("|")[1] for line in (DOCS / page).read_text("utf-8").splitlines() if line.startswith("|")]
    return {code for cell in rows for code in re.findall(r"`([a-z_]+)`", cell)}


def test_every_error_has_its_row_in_troubleshooting():
    codes = set(meanings()) | {ServiceUnreachable.code, UnexpectedReply.code}
    assert len(codes) > 15
    missing = codes - first_cells("troubleshooting.md")
    assert not missing, f"docs/troubleshooting.md says nothing of {sorted(missing)}"


def test_every_status_in_troubleshooting_is_right():
    text = (DOCS / "troubleshooting.md").read_text("utf-8")
    for code, status in meanings().items():
        row = re.search(rf"^\| `{code}` \| ([^|]+) \|", text, re.MULTILINE)
        assert row is not None
        assert str(status.http) in row[1], f"{code} has status {status.http}"


@pytest.mark.parametrize("page", ["troubleshooting.md", "limits.md", "http.md"])
def test_every_flag_has_its_row(page):
    flags = flags_of_the_service()
    assert len(flags) >= 7
    missing = flags - first_cells(page)
    assert not missing, f"docs/{page} says nothing of {sorted(missing)}"


def test_the_page_on_materials_lists_them_all(reference):
    table = reference.materials_table()
    assert all(f"| `{name}` |" in table for name in MATERIALS)
    assert "~2 MPa" in table
    assert "<!-- materials -->" in (DOCS / "materials.md").read_text("utf-8")


def test_the_http_reference_has_every_route_and_links_to_documents_that_are_there(reference):
    text = reference.http_reference()
    for route in ("POST `/v1/deform`", "GET `/v1/materials`", "GET `/healthz`"):
        assert f"### {route}" in text
    headings = {line.removeprefix("### ").lower() for line in text.splitlines() if line.startswith("### ")}
    linked = set(re.findall(r"\]\(#(\w+)\)", text))
    assert linked <= headings
    assert "| `force_n` | (number, number, number) | yes |" in text


def test_the_grpc_reference_has_every_message_with_its_comments(reference):
    proto = (ROOT / "proto/physnet/v1/deformation.proto").read_text("utf-8")
    text = reference.grpc_reference(proto)
    assert set(re.findall(r"^(?:message|enum|service) (\w+)", proto, re.MULTILINE)) <= set(
        re.findall(r"^## (\w+)", text, re.MULTILINE)
    )
    assert set(re.findall(r"rpc (\w+)\(", proto)) <= set(re.findall(r"^### (\w+)", text, re.MULTILINE))
    assert "| `young_modulus_pa` | optional double | Young's modulus, positive. |" in text
    fields = re.findall(r"^  (?:optional |repeated )?(?:[\w.]+|map<.+>) (\w+) = \d+;", proto, re.MULTILINE)
    assert all(f"`{field}`" in text for field in fields)


def test_the_command_line_reference_has_every_command(reference):
    text = reference.command_reference()
    for command in ("serve", "predict", "materials", "models", "doctor", "completion"):
        assert f"## physnet {command}\n" in text
    assert "130: interrupted" in text


def test_model_cards_are_those_that_are_shipped(reference):
    text = reference.model_cards(ROOT / "models")
    names = [path.name for path in (ROOT / "models").iterdir() if path.is_dir()]
    assert names
    assert all(name in text for name in names)


@pytest.mark.parametrize(
    ("markdown", "written"),
    [
        ("see [the card](../models/a/CARD.md)", "see the card (`models/a/CARD.md`)"),
        ("![plot](../benchmarks/x.png)", "![plot](outside/benchmarks/x.png)"),
        ("[http](http.md) and ![mug](images/mug.png)", "[http](http.md) and ![mug](images/mug.png)"),
        ("[`proto/a.proto`](../proto/a.proto)", "`proto/a.proto`"),
    ],
)
def test_links_that_leave_the_site_become_paths(reference, markdown, written):
    assert reference.leave_site(markdown, "page.md") == written


def test_a_link_between_folders_of_the_site_stays(reference):
    assert reference.leave_site("[http](../http.md)", "pipeline/decode.md") == "[http](../http.md)"


def test_every_page_is_in_the_navigation():
    navigation = (ROOT / "mkdocs.yml").read_text("utf-8").partition("\nnav:")[2]
    pages = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    missing = {page for page in pages if page not in navigation}
    assert not missing, f"add to nav in mkdocs.yml: {sorted(missing)}"


PAGES = sorted(path.relative_to(ROOT).as_posix() for path in [*DOCS.rglob("*.md"), ROOT / "README.md"])


@pytest.mark.parametrize("page", PAGES)
def test_links_between_files_lead_somewhere(page):
    """As the repository shows them, without the site; generated pages exist on the site alone."""
    generated = {"reference/http-api.md", "reference/grpc-api.md", "reference/command-line.md", "model-card.md"}
    text = re.sub(r"```.*?```", "", (ROOT / page).read_text("utf-8"), flags=re.DOTALL)
    for target in re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", text):
        if target.startswith("http") or any(target.endswith(name) for name in generated):
            continue
        assert ((ROOT / page).parent / target).exists(), f"{page} links to {target}, which is not there"


def test_what_a_page_loads_from_elsewhere_is_found(reference):
    page = """<script src="https://a.example/x.js"></script><script src="assets/y.js"></script>
        <link rel="stylesheet" href="//b.example/z.css"><link rel="canonical" href="https://c.example/">
        <link rel="icon" href="assets/i.png"><a href="https://d.example/">read</a>"""
    assert reference.loaded_from_elsewhere(page) == ["https://a.example/x.js", "//b.example/z.css"]
