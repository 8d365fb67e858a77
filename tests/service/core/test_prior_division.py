import numpy as np
import pytest

from service.core.arrays import Occupancy
from service.core.extent import filled_range
from service.core.prior_division import NARROWEST, Division, divide


def held(rest: Occupancy, division: Division) -> int:
    """Cells that hold the centre of a voxel, the plain way."""
    places = np.argwhere(rest)
    first, end = places.min(axis=0), places.max(axis=0) + 1
    cells = np.floor((places - first + 0.5) * division / (end - first)).astype(int)
    return len(np.unique(cells, axis=0))


def divided(rest: Occupancy, cells: int) -> Division:
    filled = filled_range(rest)
    assert filled is not None
    return divide(rest, *filled, cells)


def table() -> Occupancy:
    """A top on four legs: a seventh of its box."""
    rest = np.zeros((64, 64, 64), bool)
    rest[8:56, 11:53, 37:43] = True
    for x in (8, 48):
        for y in (11, 45):
            rest[x : x + 8, y : y + 8, :37] = True
    return rest


@pytest.mark.parametrize("cells", [60, 216, 300, 500])
def test_about_as_many_as_wanted_hold_material(cells: int) -> None:
    assert held(table(), divided(table(), cells)) == pytest.approx(cells, rel=0.3)


def test_a_body_that_fills_its_box_has_as_many_cells_as_wanted() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[5:37, 9:57, 3:51] = True
    division = divided(rest, 300)
    assert np.prod(division) == pytest.approx(300, rel=0.2)
    edges = np.array([32, 48, 48]) / division
    assert edges.max() < 1.3 * edges.min()


def test_a_hollow_body_is_not_cut_finer_than_its_voxels() -> None:
    index = np.indices((64, 64, 64)) - 31.5
    shell = np.abs(np.sqrt((index**2).sum(axis=0)) - 25.0) < 0.6
    division = divided(shell, 4000)
    assert (52 / np.array(division) >= 0.95 * NARROWEST).all()


def test_where_in_the_grid_it_stands_says_nothing() -> None:
    moved = np.roll(table(), (3, -5, 11), axis=(0, 1, 2))
    assert divided(moved, 300) == divided(table(), 300)


def test_a_single_voxel_is_one_cell() -> None:
    rest = np.zeros((64, 64, 64), bool)
    rest[63, 0, 63] = True
    assert divided(rest, 300) == (1, 1, 1)
