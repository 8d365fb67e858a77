"""The programs in the pages on both wires run as they stand against the real service, one after the other."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import httpx
import pytest

from tests.conftest import ROOT, LiveService


def programs(page: str, service: LiveService) -> list[str]:
    """Python of a page, with the addresses of the service and a machine's own time in place of a robot's."""
    text = (ROOT / "docs" / page).read_text("utf-8")
    found = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    return [
        program.replace("http://127.0.0.1:8000", service.url)
        .replace("127.0.0.1:8001", service.grpc)
        .replace('"200"', '"9000"')
        .replace("timeout=0.2", "timeout=30")
        for program in found
        if "triton" not in program
    ]


@pytest.fixture(autouse=True)
def in_the_checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def test_the_programs_of_the_http_page(live_service: LiveService) -> None:
    names: dict[str, Any] = {}
    asked: list[tuple[str, dict[str, Any]]] = []
    for program in programs("http.md", live_service):
        if "httpx" in program:
            program = program.replace("httpx.Client(", "httpx.Client(timeout=30, ")
        exec(compile(program, "docs/http.md", "exec"), names)
        asked += [(name, names[name]) for name in ("request", "again") if re.search(rf"^{name} = ", program, re.M)]
    assert names["deformed"].shape == (64, 64, 64)
    assert abs(names["now"] - names["before"]).max() > 1e-4
    assert abs(names["field_m"][:, names["deformed"]]).max() > 1e-4
    assert [name for name, _ in asked] == ["request", "request", "again"]
    for name, body in asked[1:]:
        reply = httpx.post(f"{live_service.url}/v1/deform", json=body, timeout=30)
        assert reply.status_code == 200, (name, reply.text)


def test_the_programs_of_the_grpc_page(live_service: LiveService) -> None:
    names: dict[str, Any] = {}
    for program in programs("grpc.md", live_service):
        if "rpc_status" in program:
            # The page goes on with a channel that is still open.
            inside = ["stub = DeformationServiceStub(channel)", *program.splitlines()]
            program = f"with grpc.insecure_channel({live_service.grpc!r}) as channel:\n    " + "\n    ".join(inside)
        exec(compile(program, "docs/grpc.md", "exec"), names)
    assert names["deformed"].any()
    soft, first = names["softer"].loads[0], names["response"].loads[0]
    assert soft.load_number != first.load_number
    assert names["moved_m"].shape == (3, names["deformed"].sum()) and abs(names["moved_m"]).max() > 1e-4
    assert names["problem"].code == "invalid_request"


def test_the_shell_of_the_http_page_names_files_that_are_there() -> None:
    text = (ROOT / "docs" / "http.md").read_text("utf-8")
    folder = Path(re.search(r"^cd (\S+)$", text, re.M)[1])
    for name in ("intrinsics.json", *re.findall(r"@(\w+\.png)", text)):
        assert (folder / name).is_file(), name
