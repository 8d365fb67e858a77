import time

import pytest

from tests.training.simulation.bodies import box, bridge, sphere, union
from training.simulation.body import Body
from training.simulation.gaps import MAX_NARROW_GAPS, narrow_gaps


def fork(gap):
    """Two upright plates on a foot, `gap` apart, both faces of the slit off the grid."""
    plates = [box([0.517 + side * (0.1 + gap / 2), 0.5, 0.4], [0.1, 0.2, 0.3]) for side in (-1, 1)]
    return union(*plates, box([0.517, 0.5, 0.1], [0.3, 0.2, 0.1]))


@pytest.mark.parametrize("cells", [24, 32])
def test_a_slit_under_a_cell_wide_is_seen_and_one_of_two_cells_is_not(cells):
    for width in (0.3, 0.8):
        assert narrow_gaps(Body.from_distance(fork(width / cells), cells)) > MAX_NARROW_GAPS
    assert narrow_gaps(Body.from_distance(fork(2.1 / cells), cells)) == 0.0


def test_finer_cells_open_a_slit():
    shape = fork(1.1 / 24)
    assert narrow_gaps(Body.from_distance(shape, 16)) > MAX_NARROW_GAPS
    assert narrow_gaps(Body.from_distance(shape, 48)) == 0.0


@pytest.mark.parametrize("shape", [sphere([0.5, 0.5, 0.28], 0.3), bridge()], ids=["ball", "bridge"])
def test_bodies_without_a_slit_have_none(shape):
    assert narrow_gaps(Body.from_distance(shape, 24)) == 0.0


def test_the_check_is_cheap():
    """About 10 ms on a quiet core; ten times that fails."""
    body = Body.from_distance(fork(0.03), 24)
    start = time.process_time()
    for _ in range(5):
        narrow_gaps(body)
    assert (time.process_time() - start) / 5 < 0.1
