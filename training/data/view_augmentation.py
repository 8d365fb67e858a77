"""Views of bodies that were never drawn, from views that were: stretched, turned and leaning, seen by a worse sensor.

A linear map takes rays to rays and what hides to what hides: the image of a view is the view that a camera, mapped
along, has of the image of the body. The support plane is kept, and the grid is laid around what is seen as the service
lays it, so that the outcome is as valid as the view it came from. What a sensor says less of, teaches nothing wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64, Int

from service.core.arrays import GRID_SIZE, Matrix3, Occupancy, Vector3
from service.core.compiled import compiled
from service.core.voxels import OUTLIER_PERCENTILE

LARGEST_ZOOM = 1.4
"""A sensor that misses most of a body lays its grid around the rest; not nearer than this here, or much is cut off."""


@dataclass(frozen=True)
class ViewAugmentation:
    """How far views are changed; each share is of views, and each of the changes falls on its own.

    Attributes:
        mapped: Share that is mapped linearly; the others keep their surfaces to the voxel.
        stretch: Deviation of the logarithm of the factor along each axis.
        shear: Deviation of what x adds to y, and y to x.
        lean: Deviation of what z adds to x and y.
        leaning: Share of the mapped ones that lean at all: most things stand upright.
        turn_rad: Deviation of the turn about the vertical.
        holed: Share in which the sensor reads nothing in a cylinder about a line of sight.
        hole_voxels: Largest radius of it.
        shadowed: Share in which nothing is known of some voxels beside and behind the surface.
        shadow_voxels: Most of them.
        strayed: Share in which some readings stray beside and behind the surface.
        strays: Most of them.
        thinned: Share in which observed voxels are lost one by one.
        thinning: Largest part of them.
    """

    mapped: float = 0.65
    stretch: float = 0.18
    shear: float = 0.08
    lean: float = 0.1
    leaning: float = 0.3
    turn_rad: float = 0.12
    holed: float = 0.3
    hole_voxels: float = 9.0
    shadowed: float = 0.3
    shadow_voxels: int = 4
    strayed: float = 0.25
    strays: int = 40
    thinned: float = 0.2
    thinning: float = 0.5


@dataclass(frozen=True, eq=False)
class Seen:
    """A view and the body, in one view grid."""

    observed: Occupancy
    free: Occupancy
    truth: Occupancy


def augmented(seen: Seen, config: ViewAugmentation, rng: np.random.Generator) -> Seen:
    """The view of another body by another sensor."""
    if not seen.observed.any():
        return seen
    given = seen
    if rng.random() < config.holed:
        seen = holed(seen, config.hole_voxels, rng)
    if rng.random() < config.mapped:
        seen = mapped(seen, draw_map(config, rng), given.observed)
    observed, free = seen.observed, seen.free
    if rng.random() < config.shadowed:
        free = free & ~shadow(observed, int(rng.integers(1, config.shadow_voxels + 1)))
    if rng.random() < config.thinned:
        observed = observed & (rng.random(observed.shape, np.float32) >= config.thinning * rng.random())
    if rng.random() < config.strayed:
        observed = observed | strays(observed, int(rng.integers(1, config.strays + 1)), rng)
    return Seen(observed, free & ~observed, seen.truth)


def draw_map(config: ViewAugmentation, rng: np.random.Generator) -> Matrix3:
    """A linear map that keeps the horizontal plane: a turn, then a stretch with some shear."""
    turn = rng.normal(0, config.turn_rad)
    turned = np.eye(3)
    turned[:2, :2] = [[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]]
    stretched = np.diag(np.exp(rng.normal(0, config.stretch, 3)))
    stretched[0, 1], stretched[1, 0] = rng.normal(0, config.shear, 2)
    if rng.random() < config.leaning:
        stretched[:2, 2] = rng.normal(0, config.lean, 2)
    linear: Matrix3 = stretched @ turned
    return linear


def mapped(seen: Seen, linear: Matrix3, placed_as: Occupancy) -> Seen:
    """The image of a view under a linear map that keeps the horizontal plane, looked up in the nearest voxel.

    Beyond the grid it is as free as at its rim, and nothing is there.

    Args:
        seen: The view.
        linear: Of places in voxels from the corner of the grid.
        placed_as: As in `placement`.
    """
    zoomed, offset = placement(seen.observed, linear, placed_as)
    view_from_image = np.linalg.inv(zoomed)
    observed, free, truth = (np.empty((GRID_SIZE,) * 3, np.bool_) for _ in range(3))
    first = view_from_image @ (0.5 - offset)
    _look_up(seen.observed, seen.free, seen.truth, view_from_image, first, observed, free, truth)
    return Seen(observed, free, truth)


def placement(observed: Occupancy, linear: Matrix3, placed_as: Occupancy) -> tuple[Matrix3, Vector3]:
    """Where the image comes to lie: the map times a zoom, and what is added to that.

    Args:
        observed: Voxels that are mapped.
        linear: Of places in voxels from the corner of the grid.
        placed_as: Voxels that the grid was laid around. The image begins along x where these begin, has its middle
            along y where they have it, and is as large. To lay the grid around the image alone would move it: the
            service lays it around points, which lie closer where the camera is near.
    """
    before, after = extent(placed_as, np.eye(3)), extent(observed, linear)
    zoom = min(float((before[:, 1] - before[:, 0]).max() / (after[:, 1] - after[:, 0]).max()), LARGEST_ZOOM)
    return zoom * linear, np.array([before[0, 0] - zoom * after[0, 0], (before[1] - zoom * after[1]).mean(), 0.0])


def extent(observed: Occupancy, linear: Matrix3) -> Float64[np.ndarray, "axis=3 low_high=2"]:
    """Where the images of the observed voxels begin and end, without outliers; along z they begin on the floor."""
    places = (voxels_of(observed) + 0.5) @ linear.T
    sides: Float64[np.ndarray, "axis=3 low_high=2"]
    sides = np.percentile(places, (OUTLIER_PERCENTILE, 100 - OUTLIER_PERCENTILE), axis=0).T
    sides[2, 0] = 0.0
    sides[:, 1] = np.maximum(sides[:, 1], sides[:, 0] + 1.0)
    return sides


def voxels_of(grid: Occupancy) -> Int[np.ndarray, "n axis=3"]:
    """Indices of the voxels, as `np.argwhere` has them, in a tenth of its time."""
    return np.stack(np.unravel_index(np.flatnonzero(grid), grid.shape), axis=1)


@compiled
def _look_up(
    observed: Occupancy, free: Occupancy, truth: Occupancy, linear: Matrix3, first: Vector3,
    observed_there: Occupancy, free_there: Occupancy, truth_there: Occupancy,
) -> None:  # fmt: skip
    """Each voxel of the image from the place `first` + `linear` · index of the source."""
    last = GRID_SIZE - 1
    for i in range(GRID_SIZE):
        for j in range(GRID_SIZE):
            for k in range(GRID_SIZE):
                x = math.floor(first[0] + linear[0, 0] * i + linear[0, 1] * j + linear[0, 2] * k)
                y = math.floor(first[1] + linear[1, 0] * i + linear[1, 1] * j + linear[1, 2] * k)
                z = math.floor(first[2] + linear[2, 0] * i + linear[2, 1] * j + linear[2, 2] * k)
                a, b, c = min(max(x, 0), last), min(max(y, 0), last), min(max(z, 0), last)
                inside = a == x and b == y and c == z
                observed_there[i, j, k] = inside and observed[a, b, c]
                truth_there[i, j, k] = inside and truth[a, b, c]
                free_there[i, j, k] = free[a, b, c]


def holed(seen: Seen, radius: float, rng: np.random.Generator) -> Seen:
    """Nothing is read in a cylinder through an observed voxel, along one of the directions that cameras look in."""
    places = voxels_of(seen.observed)
    through = places[rng.integers(len(places))]
    elevation, azimuth = math.radians(rng.uniform(10, 65)), rng.normal(0, 0.25)
    level = math.cos(elevation)
    sight = np.array([level * math.cos(azimuth), level * math.sin(azimuth), -math.sin(elevation)])
    known = ~cylinder(through.astype(np.float64), sight, float(rng.uniform(1.5, radius)))
    left = seen.observed & known
    if 2 * left.sum() < len(places):
        return seen
    return Seen(left, seen.free & known, seen.truth)


def cylinder(through: Vector3, axis: Vector3, radius: float) -> Occupancy:
    """Voxels nearer than a radius to a line through a voxel, along a unit vector."""
    x, y, z = np.ogrid[:GRID_SIZE, :GRID_SIZE, :GRID_SIZE]
    x, y, z = x - through[0], y - through[1], z - through[2]
    along = x * axis[0] + y * axis[1] + z * axis[2]
    return np.asarray(x * x + y * y + z * z - along * along < radius * radius, np.bool_)


def shadow(observed: Occupancy, width: int) -> Occupancy:
    """Voxels within `width` of an observed one along y, z and, behind it, x: what is before it was crossed by rays."""
    reached = observed
    for axis, sides in ((0, (1,)), (1, (1, -1)), (2, (1, -1))):
        spread = reached.copy()
        for step in range(1, width + 1):
            for side in sides:
                to, source = [slice(None)] * 3, [slice(None)] * 3
                to[axis], source[axis] = (
                    (slice(step, None), slice(None, -step)) if side > 0 else (slice(None, -step), slice(step, None))
                )
                spread[tuple(to)] |= reached[tuple(source)]
        reached = spread
    return reached


def strays(observed: Occupancy, count: int, rng: np.random.Generator) -> Occupancy:
    """Single voxels beside the surface, and farther behind it."""
    strayed = np.zeros_like(observed)
    places = voxels_of(observed)
    if len(places):
        aside = rng.normal(0, (0.0, 3.0, 3.0), (count, 3))
        aside[:, 0] = rng.exponential(6.0, count)
        chosen = np.rint(places[rng.integers(len(places), size=count)] + aside).astype(int)
        chosen = chosen[((chosen >= 0) & (chosen < GRID_SIZE)).all(axis=1)]
        strayed[tuple(chosen.T)] = True
    return strayed
