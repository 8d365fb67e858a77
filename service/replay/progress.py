"""What a person sees while a recording plays, and after it."""

from __future__ import annotations

import math
import shutil
import time
from typing import Protocol, runtime_checkable

from service.replay.player import Summary

PERCENTILES = (50.0, 95.0, 99.0)

PERIOD_S = 0.1
"""Between two lines: faster than that nobody reads."""

BAR = 10
"""Characters of the bar."""


@runtime_checkable
class Stream(Protocol):
    """What text is written to."""

    def write(self, text: str, /) -> object: ...
    def flush(self) -> object: ...
    def isatty(self) -> bool: ...


class ProgressLine:
    """One line that is written over itself, on a terminal; nothing elsewhere.

    Args:
        out: Where it is written.
        duration_s: Of what is played, for a bar; 0 where nobody knows.
    """

    def __init__(self, out: Stream, duration_s: float = 0.0) -> None:
        self._out = out
        self._duration_s = duration_s
        self._shown = out.isatty()
        self._last = -math.inf

    def __call__(self, summary: Summary) -> None:
        """Show where things stand."""
        now = time.monotonic()
        if not self._shown or now - self._last < PERIOD_S:
            return
        self._last = now
        # A line that the terminal breaks could not be written over.
        room = shutil.get_terminal_size().columns - 1
        shown = bar(summary.recorded_s / self._duration_s) if self._duration_s > 0.0 else ""
        self._out.write("\r\x1b[K" + (shown + line(summary))[:room])
        self._out.flush()

    def end(self) -> None:
        """Leave the line behind."""
        if self._shown and self._last > -math.inf:
            self._out.write("\r\x1b[K")
            self._out.flush()


def bar(share: float) -> str:
    """How far it is: `━━━━──────`."""
    done = min(BAR, int(share * BAR))
    return "━" * done + "─" * (BAR - done)


def line(summary: Summary) -> str:
    """Where things stand, in a line: `  12.3 s  frames 369  answered 61 (5.0/s)  skipped 307  failed 1  p50 163 ms`."""
    rate = summary.answered / summary.played_s if summary.played_s > 0.0 else 0.0
    return (
        f"{summary.recorded_s:7.1f} s  frames {summary.sent}  answered {summary.answered} ({rate:.1f}/s)  "
        f"skipped {summary.skipped}  failed {summary.failed}  p50 {_ms(summary.percentile_ms(50.0))}"
    )


def report(summary: Summary) -> str:
    """What came of it, for a person."""
    rows = [
        ("recording", f"{summary.recorded_s:.2f} s, played in {summary.played_s:.2f} s"),
        ("frames", f"{summary.sent}"),
        ("answered", f"{summary.answered}"),
        ("skipped", f"{summary.skipped} (a newer frame was there before their turn)"),
        ("failed", f"{summary.failed}"),
    ]
    rows += [
        (f"  {code}", f"{times} times: {words}") for code, (times, words) in sorted(summary.problems.items())
    ]
    if summary.round_trip_ms:
        figures = ", ".join(f"p{percent:.0f} {_ms(summary.percentile_ms(percent))}" for percent in PERCENTILES)
        rows.append(("latency", f"{figures}, most {_ms(max(summary.round_trip_ms))} from frame to answer"))
    return "\n".join(f"{name:12s}{words}" for name, words in rows)


def document(summary: Summary) -> dict[str, object]:
    """What came of it, as JSON."""
    return {
        "frames": summary.sent,
        "answered": summary.answered,
        "skipped": summary.skipped,
        "failed": summary.failed,
        "recorded_s": summary.recorded_s,
        "played_s": summary.played_s,
        "problems": {code: times for code, (times, _) in sorted(summary.problems.items())},
        "round_trip_ms": {
            f"p{percent:.0f}": summary.percentile_ms(percent) for percent in PERCENTILES
        } if summary.round_trip_ms else None,
    }  # fmt: skip


def _ms(milliseconds: float) -> str:
    return "–" if math.isnan(milliseconds) else f"{milliseconds:.0f} ms"
