import math

import numpy as np
import pytest

from service.bench.histogram import Histogram


def test_percentiles_are_those_of_the_times_to_three_digits() -> None:
    times_ms = np.random.default_rng(0).lognormal(3.0, 1.0, 20_000)
    histogram = Histogram()
    for time_ms in times_ms:
        histogram.record(time_ms)
    for percent in (1.0, 50.0, 90.0, 99.0, 99.9, 100.0):
        exact = np.sort(times_ms)[max(1, math.ceil(percent / 100 * len(times_ms))) - 1]
        assert histogram.percentile(percent) == pytest.approx(exact, rel=2e-3)
    assert histogram.mean_ms == pytest.approx(times_ms.mean())
    assert histogram.largest_ms == times_ms.max()
    shares = list(histogram.curve())
    assert shares[-1] == (1.0, times_ms.max())
    assert shares == sorted(shares)


@pytest.mark.parametrize("milliseconds", [0.0, 0.001, 1.023, 1.024, 20.0, 3.6e6])
def test_every_magnitude_has_its_bucket(milliseconds: float) -> None:
    histogram = Histogram()
    histogram.record(milliseconds)
    assert histogram.percentile(50.0) == pytest.approx(milliseconds, rel=1e-3, abs=1e-3)


def test_a_caller_that_waited_left_questions_out() -> None:
    """One stall of 100 ms among answers of 1 ms, asked every 10 ms: nine more would have met the stall."""
    histogram = Histogram()
    for _ in range(90):
        histogram.record_corrected(1.0, 10.0)
    histogram.record_corrected(100.0, 10.0)
    assert histogram.count == 90 + 10
    assert histogram.percentile(90.0) == pytest.approx(1.0, rel=2e-3)
    assert histogram.percentile(95.0) == pytest.approx(50.0, rel=2e-3)


def test_nothing_recorded_has_no_percentiles() -> None:
    assert math.isnan(Histogram().percentile(50.0))
    assert math.isnan(Histogram().mean_ms)
