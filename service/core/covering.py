"""What was measured and a reconstruction lacks."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int32

from service.core.arrays import GRID_SIZE, Bytes, Eights, Occupancy
from service.core.compiled import compiled

LEAST_SHOWN = 16
"""Voxels of a patch that counts as matter.

Fewer are readings that strayed: left in, they float a voxel or two off the body and make it taller than it is. On the
35 scenes and 29 real objects of the tests nearly all patches have fewer, most of them one or two voxels.
"""

_EMPTY, _FILLED, _MISSING = np.uint8(0), np.uint8(1), np.uint8(2)


def cover(occupancy: Occupancy, observed: Occupancy) -> Occupancy:
    """Add the observed voxels that have no filled voxel among their 26 neighbours, where `LEAST_SHOWN` of them or more
    hang together.

    A surface passes between voxel centres, so about half of the observed voxels belong to the body and half do not;
    filling all of them would fatten it by half a voxel. Farther than one voxel off the body, a patch of measured points
    shows something that the body lacks.
    """
    filled, shown = np.ascontiguousarray(occupancy), np.ascontiguousarray(observed)
    covered = np.empty(filled.shape, np.uint8)
    _cover(filled, shown, filled.view(np.uint64), shown.view(np.uint64), covered, covered.view(np.uint64))
    return covered.view(np.bool_)


@compiled
def _cover(
    occupancy: Occupancy, observed: Occupancy, filled_eights: Eights, observed_eights: Eights, covered: Bytes,
    covered_eights: Eights,
) -> None:  # fmt: skip
    """`cover`: what is filled, and the patches; as many places are listed as are observed and not filled at most."""
    count = 0
    for i in range(GRID_SIZE):
        for j in range(GRID_SIZE):
            for eight in range(GRID_SIZE // 8):
                covered_eights[i, j, eight] = filled_eights[i, j, eight]
                count += _ones(observed_eights[i, j, eight] & ~filled_eights[i, j, eight])
    places = np.empty((count, 3), np.int32)
    count = _missing(occupancy, observed, filled_eights, observed_eights, covered, places)
    _keep_patches(covered, places[:count], np.empty((count, 3), np.int32))


@compiled
def _ones(eight: np.uint64) -> int:
    """How many of eight voxels are filled."""
    return int(eight * np.uint64(0x0101010101010101) >> np.uint64(56))


@compiled
def _missing(
    occupancy: Occupancy,
    observed: Occupancy,
    filled_eights: Eights,
    observed_eights: Eights,
    covered: Bytes,
    places: Int32[np.ndarray, "n 3"],
) -> int:
    """Mark and list the observed voxels that are not filled and have no filled neighbour; returns their number."""
    count, last = 0, GRID_SIZE - 1
    around, alone = np.empty(GRID_SIZE + 2, np.bool_), np.empty(GRID_SIZE, np.bool_)
    for i in range(GRID_SIZE):
        for j in range(GRID_SIZE):
            unfilled = np.uint64(0)
            for eight in range(GRID_SIZE // 8):
                unfilled |= observed_eights[i, j, eight] & ~filled_eights[i, j, eight]
            if unfilled == 0:
                continue
            around[:] = False
            for x in range(max(i - 1, 0), min(i + 1, last) + 1):
                for y in range(max(j - 1, 0), min(j + 1, last) + 1):
                    for k in range(GRID_SIZE):
                        around[k + 1] |= occupancy[x, y, k]
            some = False
            for k in range(GRID_SIZE):
                alone[k] = observed[i, j, k] > (around[k] | around[k + 1] | around[k + 2])
                some |= alone[k]
            if not some:
                continue
            for k in range(GRID_SIZE):
                if alone[k]:
                    covered[i, j, k] = _MISSING
                    places[count, 0], places[count, 1], places[count, 2] = i, j, k
                    count += 1
    return count


@compiled
def _keep_patches(
    covered: Bytes, places: Int32[np.ndarray, "n 3"], patch: Int32[np.ndarray, "n 3"]
) -> None:
    """Fill the marked voxels of every patch (26 neighbours) that is large enough, and empty those of the others."""
    last = GRID_SIZE - 1
    for n in range(len(places)):
        if covered[places[n, 0], places[n, 1], places[n, 2]] != _MISSING:
            continue
        patch[0] = places[n]
        covered[places[n, 0], places[n, 1], places[n, 2]] = _FILLED
        size, looked_at = 1, 0
        while looked_at < size:
            i, j, k = patch[looked_at]
            looked_at += 1
            for x in range(max(i - 1, 0), min(i + 1, last) + 1):
                for y in range(max(j - 1, 0), min(j + 1, last) + 1):
                    for z in range(max(k - 1, 0), min(k + 1, last) + 1):
                        if covered[x, y, z] == _MISSING:
                            covered[x, y, z] = _FILLED
                            patch[size, 0], patch[size, 1], patch[size, 2] = x, y, z
                            size += 1
        if size < LEAST_SHOWN:
            for m in range(size):
                covered[patch[m, 0], patch[m, 1], patch[m, 2]] = _EMPTY
