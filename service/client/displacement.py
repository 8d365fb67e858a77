"""The displacement field of a reply, on the voxels of the deformed body, and what it says of single points."""

from __future__ import annotations

from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from service.core.arrays import GRID_SIZE, Occupancy, Points
from service.core.grids import on_grid

Configuration: TypeAlias = Literal["rest", "deformed"]

REACH_VOXELS = 2.0
"""A point farther than this from the body's nearest voxel centre is not a point of it. Surfaces as cameras see them lie
up to a voxel beside the reconstructed one."""

STEPS = 6
"""Of the fixed-point iteration; it halves its error or better where strains stay below a half."""

_CHUNK = 256
"""Points that are held against the same voxels at once: 256 × 20,000 floats are 20 MB."""

_CORNERS = np.stack(np.unravel_index(np.arange(8), (2, 2, 2)), axis=1)


class DisplacementField:
    """How far the material now at each voxel of a deformed body has come: half precision, metres, grid axes.

    Kept in the form in which it travelled; the other one is made where it is asked for.

    Args:
        travelled_m: On all voxels, 3 × 64³, or 3 × n on those of `deformed` alone, in C order.
        deformed: The body after the push; needed for the second form, and to have it.

    Raises:
        ValueError: It is neither.
    """

    def __init__(self, travelled_m: np.ndarray, deformed: Occupancy | None) -> None:
        if travelled_m.shape != (3, *(GRID_SIZE,) * 3) and (
            deformed is None or travelled_m.shape != (3, np.count_nonzero(deformed))
        ):
            raise ValueError(f"displacements of shape {travelled_m.shape} are not those of the body beside them")
        self._travelled_m = travelled_m
        self._deformed = deformed

    @cached_property
    def grid_m(self) -> np.ndarray:
        """3 × 64³, zero outside the body."""
        if self._travelled_m.ndim == 4:
            return self._travelled_m
        assert self._deformed is not None
        return on_grid(self._travelled_m, self._deformed)

    @cached_property
    def at_voxels_m(self) -> np.ndarray:
        """3 × n, in the order in which voxels are set in `deformed`, C order."""
        if self._travelled_m.ndim == 2:
            return self._travelled_m
        assert self._deformed is not None
        return self._travelled_m[:, self._deformed]


def displacement_at(
    points_m: Points, deformed: Occupancy, field_m: np.ndarray, pitch_m: float, configuration: Configuration
) -> Points:
    """Displacement at points, grid frame and axes, metres; NaN where there is no body.

    Args:
        points_m: n × 3, grid frame.
        deformed: The body after the push.
        field_m: 3 × 64³: displacement of the material now at each voxel of `deformed`.
        pitch_m: Edge of a voxel.
        configuration: Whether points are places before the push (`rest`) or after it (`deformed`).

    A place x of the deformed body is that of the material point X = x − u(x). For a point of the rest body this is
    solved for x by fixed-point iteration, x ← X + u(x), from the voxel whose material was nearest.
    """
    voxels = np.argwhere(deformed)
    if len(voxels) == 0 or len(points_m) == 0:
        return np.full((len(points_m), 3), np.nan, np.float32)
    places = (voxels + 0.5).astype(np.float32)
    moved = (field_m[:, deformed].T.astype(np.float32)) / np.float32(pitch_m)
    points = np.asarray(points_m, np.float32) / np.float32(pitch_m)
    nearest, distance = nearest_places(points, places - moved if configuration == "rest" else places)
    if configuration == "deformed":
        found = _interpolated(points, deformed, field_m, pitch_m, moved[nearest])
    else:
        found = _solved(points, deformed, field_m, pitch_m, moved[nearest])
    found[distance > REACH_VOXELS] = np.nan
    return np.asarray(found * np.float32(pitch_m), np.float32)


def _solved(
    points: np.ndarray, deformed: np.ndarray, field_m: np.ndarray, pitch_m: float, start: np.ndarray
) -> np.ndarray:
    """Voxels; of all iterates the one that misses its point least, in case they run away where strains are large."""
    best, best_miss = start, np.full(len(points), np.inf, np.float32)
    moved = start
    for _ in range(STEPS):
        after = _interpolated(points + moved, deformed, field_m, pitch_m, start)
        miss = np.linalg.norm(after - moved, axis=1)
        better = miss < best_miss
        best = np.where(better[:, None], after, best)
        best_miss = np.where(better, miss, best_miss)
        moved = after
    return best


def _interpolated(
    places: np.ndarray, deformed: np.ndarray, field_m: np.ndarray, pitch_m: float, otherwise: np.ndarray
) -> np.ndarray:
    """Trilinear over those of the eight voxels around that belong to the body; `otherwise` where none does. Voxels."""
    # An iterate may run far off; it is cut to the neighbourhood of the grid, where no voxel belongs to the body.
    position = np.clip(places - 0.5, -2.0, GRID_SIZE + 1.0)
    low = np.floor(position).astype(np.int64)
    share = position - low
    total = np.zeros((len(places), 3), np.float32)
    weights = np.zeros(len(places), np.float32)
    for corner in _CORNERS:
        voxel = low + corner
        inside = ((voxel >= 0) & (voxel < GRID_SIZE)).all(axis=1)
        x, y, z = np.where(inside[:, None], voxel, 0).T
        weight = np.prod(np.where(corner == 1, share, 1.0 - share), axis=1) * (inside & deformed[x, y, z])
        total += weight[:, None] * field_m[:, x, y, z].T
        weights += weight
    some = weights > 1e-6
    mean = total / (np.where(some, weights, 1.0) * pitch_m)[:, None]
    return np.where(some[:, None], mean, otherwise).astype(np.float32)


def nearest_places(points: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Index of, and distance to, the nearest place of each point; infinitely far where no place has a near x.

    Right wherever the nearest place is within `REACH_VOXELS`. Points are taken in the order of their x, with the places
    of a slab around them: of a body's, a seventh.

    Args:
        points: n × 3, voxels.
        places: m × 3, voxels, at least one.
    """
    index = np.zeros(len(points), np.int64)
    distance = np.full(len(points), np.inf, np.float32)
    order = places[:, 0].argsort()
    places = places[order]
    squares = (places**2).sum(axis=1)
    in_turn = points[:, 0].argsort()
    for start in range(0, len(points), _CHUNK):
        chosen = in_turn[start : start + _CHUNK]
        some = points[chosen]
        first = places[:, 0].searchsorted(some[0, 0] - REACH_VOXELS)
        last = places[:, 0].searchsorted(some[-1, 0] + REACH_VOXELS, side="right")
        if first < last:
            nearest = first + (squares[first:last] - 2.0 * some @ places[first:last].T).argmin(axis=1)
            index[chosen] = order[nearest]
            distance[chosen] = np.linalg.norm(some - places[nearest], axis=1)
    return index, distance
