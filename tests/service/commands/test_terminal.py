"""What reaches a person: colours only where they are wanted, tables that fit, a sign of life on a terminal."""

from __future__ import annotations

import io
import threading
import time

import pytest

from service.commands.terminal import ProgressLine, Terminal, bar, pascals, wants_colour
from tests.service.screen import Screen
from tests.service.waiting import until


@pytest.mark.parametrize(
    ("environment", "stream", "wanted"),
    [
        ({}, Screen(), True), ({}, io.StringIO(), False), ({"NO_COLOR": "1"}, Screen(), False),
        ({"NO_COLOR": ""}, Screen(), True), ({"TERM": "dumb"}, Screen(), False),
        ({"FORCE_COLOR": "1"}, io.StringIO(), True), ({"FORCE_COLOR": "1", "NO_COLOR": "1"}, Screen(), False),
    ],
)  # fmt: skip
def test_colours_are_for_terminals_that_want_them(environment, stream, wanted):
    assert wants_colour(stream, environment) is wanted


def test_no_color_is_stronger_than_a_terminal(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert Terminal(True, Screen()).paint("x", "red") == "\x1b[31mx\x1b[0m"
    assert Terminal(False, Screen()).paint("x", "red") == "x"


def test_tables_are_cut_at_the_edge_of_a_terminal_and_nowhere_else(monkeypatch):
    monkeypatch.setenv("COLUMNS", "20")
    rows = [("ab", "1", "a long description"), ("c", "22", "another one")]
    screen, pipe = Screen(), io.StringIO()
    Terminal(False, screen).table(rows, right=(1,))
    assert screen.getvalue().splitlines() == ["ab   1  a long desc…", "c   22  another one"]
    Terminal(False, pipe).table(rows, right=(1,))
    assert pipe.getvalue().splitlines()[0].endswith("a long description")


def test_what_takes_long_shows_that_it_lives():
    screen = Screen()
    with Terminal(False, io.StringIO(), screen).working("opening the models"):
        assert until(lambda: "opening the models" in screen.getvalue())
    # And leaves nothing behind.
    assert screen.getvalue().endswith("\r\x1b[K")


def test_what_is_quick_or_piped_shows_nothing():
    screen, pipe = Screen(), io.StringIO()
    with Terminal(False, io.StringIO(), screen).working("x"):
        pass
    with Terminal(False, io.StringIO(), pipe).working("x"):
        time.sleep(0.5)
    assert screen.getvalue() == pipe.getvalue() == ""


def test_progress_is_written_over_itself_on_a_terminal_alone(monkeypatch):
    monkeypatch.setenv("COLUMNS", "12")
    screen, pipe = Screen(), io.StringIO()
    for out in (screen, pipe):
        progress = ProgressLine(out, period_s=60.0)
        progress.show(lambda: "half of it is done")
        progress.show(lambda: pytest.fail("too soon to be read"))
        progress.end()
    # What would be broken into two lines could not be written over.
    assert screen.getvalue() == "\r\x1b[Khalf of it \r\x1b[K"
    assert pipe.getvalue() == ""


def test_a_bar_is_as_full_as_its_share():
    assert [bar(share) for share in (0.0, 0.49, 1.0, 1.2)] == ["─" * 10, "━━━━──────", "━" * 10, "━" * 10]


def test_whoever_is_watched_is_not_asked_to_tell():
    """The line is made by another thread, now and then, and by none where nobody sees it."""
    threads = []

    def tell() -> str:
        threads.append(threading.current_thread())
        return f"{len(threads)} looks"

    screen = Screen()
    with Terminal(False, io.StringIO(), screen).watching(tell, period_s=0.05):
        assert until(lambda: "2 looks" in screen.getvalue())
    assert threading.current_thread() not in threads and not threads[0].is_alive()
    assert screen.getvalue().endswith("looks\r\x1b[K")
    with Terminal(False, io.StringIO(), io.StringIO()).watching(pytest.fail, period_s=0.0):
        time.sleep(0.4)


@pytest.mark.parametrize(
    ("e_pa", "text"),
    [(5.6e4, "56 kPa"), (1.142e6, "1.14 MPa"), (2.1e11, "210 GPa"), (999.9e3, "1 MPa"), (12.0, "12 Pa")],
)
def test_moduli_are_read_in_three_digits(e_pa, text):
    assert pascals(e_pa) == text
