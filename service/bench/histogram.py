"""A histogram of latencies with the same relative precision from microseconds to hours."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

_BITS = 10
"""Values are told apart to one part in 2¹⁰: three digits, as HdrHistogram's usual precision."""

_SCALES = 36
"""Powers of two of microseconds: up to 2³⁶ µs, nineteen hours."""


class Histogram:
    """Counts of times in logarithmic buckets that are each cut into 2¹⁰ linear ones.

    Source: G. Tene, HdrHistogram (hdrhistogram.org); its correction for coordinated omission is `record_corrected`.
    """

    def __init__(self) -> None:
        self._counts = np.zeros((_SCALES, 2**_BITS), np.int64)
        self._sum_ms = 0.0
        self._largest_ms = 0.0

    def record(self, milliseconds: float) -> None:
        """Count one time, not negative."""
        scale, step = _bucket(milliseconds)
        self._counts[scale, step] += 1
        self._sum_ms += milliseconds
        self._largest_ms = max(self._largest_ms, milliseconds)

    def record_corrected(self, milliseconds: float, interval_ms: float) -> None:
        """Count a time measured by a caller that waits for its reply before it asks again, once every `interval_ms`.

        While it waited it left questions out that would have waited, too, each an interval less than the one before.
        Times counted from when a question was due need no such correction.
        """
        self.record(milliseconds)
        if interval_ms > 0.0:
            left_out = milliseconds - interval_ms
            while left_out >= interval_ms:
                self.record(left_out)
                left_out -= interval_ms

    @property
    def count(self) -> int:
        """Times recorded."""
        return int(self._counts.sum())

    @property
    def mean_ms(self) -> float:
        return self._sum_ms / self.count if self.count else math.nan

    @property
    def largest_ms(self) -> float:
        return self._largest_ms if self.count else math.nan

    def percentile(self, percent: float) -> float:
        """The time that this share of all is not above, ms; NaN where nothing was recorded."""
        count = self.count
        if count == 0:
            return math.nan
        flat = self._counts.ravel()
        place = int(np.searchsorted(flat.cumsum(), max(1, math.ceil(percent / 100.0 * count))))
        return min(_upper_ms(place), self._largest_ms)

    def curve(self) -> Iterator[tuple[float, float]]:
        """(share not above, ms) of every bucket that holds something, upwards."""
        flat = self._counts.ravel()
        places = np.flatnonzero(flat)
        for place, share in zip(places, flat[places].cumsum() / max(self.count, 1), strict=True):
            yield float(share), min(_upper_ms(int(place)), self._largest_ms)


def _bucket(milliseconds: float) -> tuple[int, int]:
    microseconds = max(int(milliseconds * 1e3), 0)
    # The first scale holds all of 0 to 2¹⁰ µs; each further one the upper half of a range twice as wide.
    scale = max(microseconds.bit_length() - _BITS, 0)
    if scale >= _SCALES:
        return _SCALES - 1, 2**_BITS - 1
    return scale, microseconds >> scale


def _upper_ms(place: int) -> float:
    """The largest time that falls into a bucket."""
    scale, step = divmod(place, 2**_BITS)
    return float((step + 1) << scale) * 1e-3
