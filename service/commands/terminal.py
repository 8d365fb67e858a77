"""What a person sees: colours where they are wanted, tables, and how far something is that takes long."""

from __future__ import annotations

import itertools
import math
import os
import shutil
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from typing import Protocol, runtime_checkable

_CODES = {"bold": "1", "dim": "2", "red": "31", "green": "32", "yellow": "33", "cyan": "36"}
_FRAMES = "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏"
_QUIET_S = 0.3
"""What is done sooner than this needs no sign of life."""

PERIOD_S = 0.1
"""Between two lines of progress: faster than that nobody reads."""

BAR = 10
"""Characters of a bar."""


@runtime_checkable
class Stream(Protocol):
    """What text is written to."""

    def write(self, text: str, /) -> object: ...
    def flush(self) -> object: ...
    def isatty(self) -> bool: ...


def wants_colour(stream: Stream, environment: Mapping[str, str]) -> bool:
    """Whether colours reach a person: `NO_COLOR` and `TERM=dumb` switch them off, `FORCE_COLOR` on, else a terminal.

    Source: https://no-color.org: any value that is not empty counts.
    """
    if environment.get("NO_COLOR"):
        return False
    if environment.get("FORCE_COLOR"):
        return True
    return environment.get("TERM") != "dumb" and stream.isatty()


class Terminal:
    """Writes to people.

    Args:
        colour: False for `--no-color`; else the environment and the stream decide.
        out: Where results go.
        err: Where progress goes, so that a pipe gets results only.
    """

    def __init__(self, colour: bool = True, out: Stream | None = None, err: Stream | None = None) -> None:
        self._out = sys.stdout if out is None else out
        self._err = sys.stderr if err is None else err
        self._colour = colour and wants_colour(self._out, os.environ)

    def paint(self, text: str, *styles: str) -> str:
        """Text in styles: bold, dim, red, green, yellow, cyan."""
        if not (self._colour and styles):
            return text
        return f"\x1b[{';'.join(_CODES[style] for style in styles)}m{text}\x1b[0m"

    def print(self, text: str = "") -> None:
        """A line of the result."""
        print(text, file=self._out)

    def complain(self, text: str) -> None:
        """A line of what went wrong."""
        print(f"physnet: {text}", file=self._err)

    def table(self, rows: Sequence[Sequence[str]], right: Sequence[int] = (), indent: str = "") -> None:
        """Columns side by side, the last one cut where the terminal ends.

        Args:
            rows: Plain text, the same number of cells in each.
            right: Columns that are aligned to the right.
            indent: Before each line.
        """
        if not rows:
            return
        widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
        # A file or a pipe has no width, and gets all of it.
        room = shutil.get_terminal_size().columns if self._out.isatty() else 10_000
        for row in rows:
            cells = [
                cell.rjust(width) if column in right else cell.ljust(width)
                for column, (cell, width) in enumerate(zip(row, widths, strict=True))
            ]
            line = indent + "  ".join(cells).rstrip()
            self.print(line if len(line) <= room else line[: room - 1] + "…")

    def progress(self) -> ProgressLine:
        """A line that whoever works tells how far it is."""
        return ProgressLine(self._err)

    def working(self, on: str) -> AbstractContextManager[None]:
        """Say what takes long, and for how long already, on a terminal; nothing in a pipe."""
        began, frames = time.monotonic(), itertools.cycle(_FRAMES)
        return self.watching(lambda: f"{next(frames)} {on} {time.monotonic() - began:.1f} s ")

    @contextmanager
    def watching(self, tell: Callable[[], str], period_s: float = PERIOD_S) -> Iterator[None]:
        """Look from beside how far something is, on a terminal; nothing in a pipe.

        Args:
            tell: The line; called in a thread of its own.
            period_s: Between two looks.
        """
        if not self._err.isatty():
            yield
            return
        done = threading.Event()
        looking = threading.Thread(target=self._look, args=(tell, period_s, done), daemon=True)
        looking.start()
        try:
            yield
        finally:
            done.set()
            looking.join()

    def _look(self, tell: Callable[[], str], period_s: float, done: threading.Event) -> None:
        line = ProgressLine(self._err, period_s=0.0)  # it is this loop that waits
        if done.wait(_QUIET_S):
            return
        while not done.wait(period_s):
            line.show(tell)
        line.end()


class ProgressLine:
    """One line that is written over itself, on a terminal; nothing elsewhere.

    Args:
        out: Where it is written.
        period_s: Between two lines; those between are left out.
    """

    def __init__(self, out: Stream, period_s: float = PERIOD_S) -> None:
        self._out = out
        self._period_s = period_s
        self._shown = out.isatty()
        self._last = -math.inf

    def show(self, tell: Callable[[], str]) -> None:
        """Show where things stand, unless it is too soon; `tell` is called where it is not."""
        now = time.monotonic()
        if not self._shown or now - self._last < self._period_s:
            return
        self._last = now
        # A line that the terminal breaks could not be written over.
        self._out.write("\r\x1b[K" + tell()[: shutil.get_terminal_size().columns - 1])
        self._out.flush()

    def end(self) -> None:
        """Leave the line behind."""
        if self._last > -math.inf:
            self._out.write("\r\x1b[K")
            self._out.flush()


def bar(share: float) -> str:
    """How far it is: `━━━━──────`."""
    done = min(BAR, int(share * BAR))
    return "━" * done + "─" * (BAR - done)


def pascals(e_pa: float) -> str:
    """Young's modulus as people read it: `103 kPa`, `1.14 MPa`."""
    for unit, size in (("GPa", 1e9), ("MPa", 1e6), ("kPa", 1e3)):
        if e_pa >= 0.9995 * size:
            return f"{_three(e_pa / size)} {unit}"
    return f"{_three(e_pa)} Pa"


def _three(number: float) -> str:
    return f"{float(f'{number:.3g}'):g}"
