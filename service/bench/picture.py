"""A run as an SVG: latency by percentile, and every question over time. Needs no library."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape

from service.bench.open_loop import Measured
from service.bench.targets import OK, SKIPPED

_WIDTH, _HEIGHT, _MARGIN = 460, 300, 48
_COLOURS = {OK: "#1f77b4", SKIPPED: "#bbbbbb"}
_FAILED = "#d62728"
_POINTS = 4000
"""More would be one blot, and megabytes."""

Point = tuple[float, float]


def picture(measured: Measured, title: str) -> str:
    """Both panels as an SVG document."""
    curve = list(measured.latency.curve())
    answered = [(at_s, ms, outcome) for at_s, ms, outcome in measured.points]
    largest_ms = max((ms for _, ms, outcome in answered if outcome == OK), default=1.0) * 1.05
    return "\n".join(
        [
            f'<svg xmlns="http://www.w3.org/2000/svg" width="{2 * _WIDTH}" height="{_HEIGHT + 24}" '
            'font-family="sans-serif" font-size="11">',
            '<rect width="100%" height="100%" fill="white"/>',
            f'<text x="{_WIDTH}" y="16" text-anchor="middle" font-size="13">{escape(title)}</text>',
            f'<g transform="translate(0,20)">{_by_percentile(curve, largest_ms)}</g>',
            f'<g transform="translate({_WIDTH},20)">{_over_time(answered, largest_ms)}</g>',
            "</svg>\n",
        ]
    )


def _by_percentile(curve: Sequence[Point], largest_ms: float) -> str:
    """Latency against the number of nines, as HdrHistogram's plots have it."""
    nines = [(min(-math.log10(max(1.0 - share, 1e-5)), 5.0), ms) for share, ms in curve]
    furthest = max((x for x, _ in nines if x < 5.0), default=2.0) * 1.02
    line = " ".join("{:.1f},{:.1f}".format(*_place(min(x, furthest), ms, furthest, largest_ms)) for x, ms in nines)
    ticks = [(-math.log10(1.0 - p), f"{100 * p:g}") for p in (0.5, 0.9, 0.99, 0.999, 0.9999)]
    axes = _axes([(x, text) for x, text in ticks if x <= furthest], furthest, largest_ms, "percentile")
    return axes + f'<polyline fill="none" stroke="{_COLOURS[OK]}" stroke-width="1.5" points="{line}"/>'


def _over_time(points: Sequence[tuple[float, float, str]], largest_ms: float) -> str:
    last_s = max((at_s for at_s, _, _ in points), default=1.0) or 1.0
    step = max(1, len(points) // _POINTS)
    dots = []
    for at_s, ms, outcome in points[::step]:
        x, y = _place(at_s, min(ms, largest_ms), last_s, largest_ms)
        dots.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="1.2" fill="{_COLOURS.get(outcome, _FAILED)}"/>')
    ticks = [(last_s * part, f"{last_s * part:.0f}") for part in (0.0, 0.25, 0.5, 0.75, 1.0)]
    legend = f"seconds; blue answered, grey skipped, red failed{'' if step == 1 else f'; every {step}th'}"
    return _axes(ticks, last_s, largest_ms, legend) + "".join(dots)


def _axes(ticks: Iterable[tuple[float, str]], furthest: float, largest_ms: float, label: str) -> str:
    parts = []
    for x, text in ticks:
        left, bottom = _place(x, 0.0, furthest, largest_ms)
        parts.append(f'<text x="{left:.1f}" y="{bottom + 14:.1f}" text-anchor="middle">{text}</text>')
    step = 10.0 ** math.floor(math.log10(largest_ms))
    step *= next(factor for factor in (0.2, 0.5, 1.0, 2.0) if largest_ms / (step * factor) <= 8)
    for tick in range(int(largest_ms / step) + 1):
        _, y = _place(0.0, tick * step, furthest, largest_ms)
        parts.append(f'<line x1="{_MARGIN}" x2="{_WIDTH - 12}" y1="{y:.1f}" y2="{y:.1f}" stroke="#dddddd"/>')
        parts.append(f'<text x="{_MARGIN - 6}" y="{y + 4:.1f}" text-anchor="end">{tick * step:g}</text>')
    parts.append(f'<text x="{_WIDTH / 2}" y="{_HEIGHT - 12}" text-anchor="middle">{escape(label)}</text>')
    parts.append(f'<text x="12" y="{_HEIGHT / 2}" transform="rotate(-90 12 {_HEIGHT / 2})">ms</text>')
    return "".join(parts)


def _place(x: float, ms: float, furthest: float, largest_ms: float) -> Point:
    return (
        _MARGIN + (_WIDTH - _MARGIN - 12) * x / furthest,
        _HEIGHT - _MARGIN - (_HEIGHT - 2 * _MARGIN) * ms / largest_ms,
    )
