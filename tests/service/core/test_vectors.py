import numpy as np

from service.core.vectors import add_share, copy, dot


def test_products_are_those_of_all_entries() -> None:
    first, second = np.random.default_rng(3).normal(size=(2, 3, 40)).astype(np.float32)
    np.testing.assert_allclose(dot(first, second), (first * second).sum(), rtol=1e-5)


def test_a_share_is_added_to_the_first_of_more() -> None:
    result = np.array([1.0, 2.0, 3.0, 4.0], np.float32)
    add_share(np.float32(0.5), np.array([2.0, -4.0], np.float32), result)
    np.testing.assert_array_equal(result, [2.0, 0.0, 3.0, 4.0])


def test_a_copy_is_written_over_what_was_there() -> None:
    values, result = np.arange(6.0, dtype=np.float32).reshape(2, 3), np.ones((2, 3), np.float32)
    copy(values, result)
    np.testing.assert_array_equal(result, values)
