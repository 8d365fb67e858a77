"""Measured matter that a reconstruction lacks is added in patches; what strays is left out."""

import numpy as np
import pytest

from service.core.covering import LEAST_SHOWN, cover

STEPS = np.array(list(np.ndindex(3, 3, 3))) - 1


def grown(occupancy: np.ndarray) -> np.ndarray:
    """The body and the 26 neighbours of its voxels."""
    padded = np.pad(occupancy, 1)
    return np.logical_or.reduce([padded[x : x + 64, y : y + 64, z : z + 64] for x, y, z in STEPS + 1])


def patches(occupancy: np.ndarray) -> list[set[tuple[int, ...]]]:
    """Voxels that hang together by faces, edges or corners."""
    left = {tuple(place) for place in np.argwhere(occupancy).tolist()}
    found = []
    while left:
        patch, edge = set(), [left.pop()]
        while edge:
            place = edge.pop()
            patch.add(place)
            near = {tuple(neighbour) for neighbour in (np.array(place) + STEPS).tolist()} & left
            left -= near
            edge += near
        found.append(patch)
    return found


@pytest.fixture
def body() -> np.ndarray:
    body = np.zeros((64, 64, 64), bool)
    body[30:34, 30:34, 0:5] = True
    return body


def test_a_patch_that_the_body_lacks_is_added(body: np.ndarray) -> None:
    handle = np.zeros_like(body)
    handle[40, 30 : 30 + LEAST_SHOWN, 2] = True
    covered = cover(body, handle)
    assert covered.dtype == np.bool_
    np.testing.assert_array_equal(covered, body | handle)


def test_a_reading_that_strayed_is_not(body: np.ndarray) -> None:
    strayed = np.zeros_like(body)
    strayed[40, 30 : 29 + LEAST_SHOWN, 2] = True
    strayed[10, 10, 60] = True
    np.testing.assert_array_equal(cover(body, strayed), body)


def test_what_touches_the_body_is_its_surface(body: np.ndarray) -> None:
    touching = np.zeros_like(body)
    touching[34, 34, 5] = True  # at a corner
    touching[29, 30:34, 0:5] = True
    np.testing.assert_array_equal(cover(body, touching), body)


def test_neither_grid_is_written_to(body: np.ndarray) -> None:
    shown = np.zeros_like(body)
    shown[50:54, 50:54, 50:54] = True
    before = body.copy(), shown.copy()
    covered = cover(body, shown)
    covered[:] = False
    np.testing.assert_array_equal(body, before[0])
    np.testing.assert_array_equal(shown, before[1])


@pytest.mark.parametrize("share", [0.02, 0.05, 0.08])
def test_it_is_what_patches_say(share: float) -> None:
    """Up to the borders of the grid, with patches of every size among them."""
    rng = np.random.default_rng(0)
    body, observed = rng.random((64, 64, 64)) < 0.002, rng.random((64, 64, 64)) < share
    missing = observed & ~grown(body)
    expected = body.copy()
    sizes = []
    for patch in patches(missing):
        sizes.append(len(patch))
        if len(patch) >= LEAST_SHOWN:
            expected[tuple(np.array(sorted(patch)).T)] = True
    assert min(sizes) < LEAST_SHOWN
    assert share < 0.05 or max(sizes) >= LEAST_SHOWN
    np.testing.assert_array_equal(cover(body, observed), expected)
