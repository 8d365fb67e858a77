"""What a person sees while a recording plays, and after it."""

from __future__ import annotations

import math

from service.replay.player import Summary

PERCENTILES = (50.0, 95.0, 99.0)


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
