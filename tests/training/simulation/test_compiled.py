import numba
import numpy as np

from training.simulation.compiled import compiled


@compiled
def _sum_of_squares(values: np.ndarray) -> float:
    """A loop."""
    total = 0.0
    for value in values:
        total += value * value
    return total


def test_a_function_is_compiled_and_keeps_its_meaning():
    assert isinstance(_sum_of_squares, numba.core.registry.CPUDispatcher)
    assert _sum_of_squares(np.array([3.0, 4.0])) == 25.0
    assert _sum_of_squares.signatures  # machine code, not the interpreter


def test_the_test_runs_type_checks_do_not_hide_kernels_from_the_compiler():
    from training.simulation.sampled import interpolated

    assert isinstance(interpolated, numba.core.registry.CPUDispatcher)
