"""`physnet bench`: one real run against a service of its own, and what it refuses."""

import json
import re
import sys
from pathlib import Path

import pytest

from service.__main__ import main
from service.commands.exits import FAILED, OK, USAGE
from tests.service.fakes import FakePredictor, running
from tests.service.screen import Screen


def test_a_service_of_our_own_is_started_measured_and_compared(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    written, drawn = tmp_path / "run.json", tmp_path / "run.svg"
    options = ["--rate", "2", "--duration", "1", "--threads", "1", "--json", str(written), "--svg", str(drawn)]
    assert main(["bench", *options, "--against-graphs"]) == OK
    document = json.loads(written.read_text())
    assert document["answered"] + document["skipped"] == document["asked"] == 2
    assert document["service"]["ready_s"] > 0.0
    assert 50.0 < document["service"]["resident_mib"] < 1000.0
    assert {"decode", "segment", "voxelize", "reconstruct", "align", "deform"} <= document["stages_ms"].keys()
    graphs = document["graphs"]
    assert {"reconstruction", "deformation"} <= graphs["medians_ms"].keys()
    assert graphs["sum_ms"] == pytest.approx(sum(graphs["medians_ms"].values()))
    assert all(median > 0.0 for median in graphs["medians_ms"].values())
    # How large it is says nothing on a machine that does other things meanwhile.
    assert graphs["ratio"] == pytest.approx(graphs["service_p50_ms"] / graphs["sum_ms"])
    assert drawn.read_text().startswith("<svg")
    assert "answered" in capsys.readouterr().out


def test_a_service_that_runs_is_asked(capsys: pytest.CaptureFixture[str]) -> None:
    with running(FakePredictor()) as service:
        given = ["--server", service.grpc, "--rate", "20", "--duration", "0.2"]
        assert main(["bench", *given]) == OK
    assert "4 asked" in capsys.readouterr().out


def test_a_terminal_sees_how_far_it_is(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    screen = Screen()
    monkeypatch.setattr(sys, "stderr", screen)
    monkeypatch.setenv("COLUMNS", "100")
    with running(FakePredictor()) as service:
        assert main(["bench", "--server", service.grpc, "--rate", "10", "--duration", "2"]) == OK
    *_, shown, left = screen.getvalue().split("\r\x1b[K")
    found = re.fullmatch(r"(━*)─*  asked (\d+) of 20  answered (\d+)  skipped (\d+)  failed 0  p50 \d+ ms", shown)
    assert found and left == ""
    asked, answered, skipped = map(int, found.groups()[1:])
    assert 0 < answered == asked - skipped
    assert abs(len(found[1]) - asked / 2) <= 1
    # What was measured is printed as ever.
    assert "20 asked" in capsys.readouterr().out


def test_failures_end_with_1() -> None:
    def refuse(request: object) -> None:
        raise RuntimeError("broken")

    with running(FakePredictor(refuse)) as service:
        address = service.url.removeprefix("http://")
        given = ["--server", address, "--target", "http-json", "--rate", "20", "--duration", "0.1"]
        assert main(["bench", *given]) == FAILED


@pytest.mark.parametrize(
    "options",
    [
        ["--rate", "0"],
        ["--duration", "nan"],
        ["--clients", "0"],
        ["--loads", "0"],
        ["--press", "3,4"],
        ["--depth", "frame.png"],
        ["--server", "localhost:1", "--against-graphs"],
    ],
)
def test_what_cannot_be_used_is_named(options: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", *options]) == USAGE
    assert options[0] in capsys.readouterr().err
