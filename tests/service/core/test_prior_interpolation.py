import numpy as np
import pytest

from service.core.prior_interpolation import interpolate


@pytest.mark.parametrize("after", [1, 5])
@pytest.mark.parametrize("continued", [False, True])
def test_a_line_is_interpolated_between_its_values_and_held_or_continued_beyond(after: int, continued: bool) -> None:
    values = np.random.default_rng(0).normal(size=(3, 4, after)).astype(np.float32)
    result = np.empty((3, 9, after), np.float32)
    interpolate(values, np.float32(-0.75), np.float32(0.5), np.float32(1.0 if continued else 0.0), result)
    place = -0.75 + 0.5 * np.arange(9)
    for a in range(3):
        for b in range(after):
            expected = np.interp(place, np.arange(4), values[a, :, b])
            if continued:
                low, high = place < 0.0, place > 3.0
                expected[low] += place[low] * (values[a, 1, b] - values[a, 0, b])
                expected[high] += (place[high] - 3.0) * (values[a, 3, b] - values[a, 2, b])
            np.testing.assert_allclose(result[a, :, b], expected, atol=1e-6)
