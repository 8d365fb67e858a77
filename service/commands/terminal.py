"""What a person sees: colours where they are wanted, tables, and a sign of life while something takes long."""

from __future__ import annotations

import os
import shutil
import sys
import threading
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Protocol, runtime_checkable

_CODES = {"bold": "1", "dim": "2", "red": "31", "green": "32", "yellow": "33", "cyan": "36"}
_FRAMES = "⠋⠙⠹⠸⠼⠴⠦⠧⠇⠏"
_QUIET_S = 0.3
"""What is done sooner than this needs no sign of life."""


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

    @contextmanager
    def working(self, on: str) -> Iterator[None]:
        """Say what takes long, and for how long already, on a terminal; nothing in a pipe."""
        if not self._err.isatty():
            yield
            return
        done = threading.Event()
        turning = threading.Thread(target=self._turn, args=(on, done), daemon=True)
        turning.start()
        try:
            yield
        finally:
            done.set()
            turning.join()

    def _turn(self, on: str, done: threading.Event) -> None:
        began = time.monotonic()
        if done.wait(_QUIET_S):
            return
        frame = 0
        while not done.wait(0.1):
            frame += 1
            self._err.write(f"\r{_FRAMES[frame % len(_FRAMES)]} {on} {time.monotonic() - began:.1f} s ")
            self._err.flush()
        self._err.write("\r\x1b[K")
        self._err.flush()


def pascals(e_pa: float) -> str:
    """Young's modulus as people read it: `103 kPa`, `1.14 MPa`."""
    for unit, size in (("GPa", 1e9), ("MPa", 1e6), ("kPa", 1e3)):
        if e_pa >= 0.9995 * size:
            return f"{_three(e_pa / size)} {unit}"
    return f"{_three(e_pa)} Pa"


def _three(number: float) -> str:
    return f"{float(f'{number:.3g}'):g}"
