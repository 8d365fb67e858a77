"""The plane that an object stands on, found by RANSAC among points of a depth image.

A support plane differs from any other plane (a wall, a face of the object itself) in three ways, and all three count
in the score: it lies near the object, nothing is seen below it (a point below speaks against a plane as loudly as one
on it speaks for it), and it is level where `up` is known.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cache

import numpy as np
from jaxtyping import Float32, Float64, Int64

from service.core.arrays import Points, Vector3
from service.core.compiled import compiled
from service.core.plane_fit import average_inliers, plane_tolerance_m, settle

HYPOTHESES = 160
"""With 40 % of the drawn points on the plane one in 16 triples is clean, so all 160 miss once in 30,000 frames."""

FINALISTS = 12
"""Hypotheses that are scored on all points."""

MAX_TILT_RAD = math.radians(15.0)
"""A plane farther than this from level is not what carries the object, where `up` is known."""

AGREEMENT_RAD = math.radians(1.0)
"""Within this the given `up` and the fitted normal say the same, and the given one is kept."""

MIN_INLIERS = 60
MIN_SHARE = 0.1
"""Share of the local weight that must lie on the plane; on real frames of objects on tables it is 0.5 and more."""


@dataclass(frozen=True)
class SupportPlane:
    """Points p with normal · p + offset_m = 0.

    Attributes:
        normal: Unit vector away from the support, against gravity.
        offset_m: Height of the camera above the plane, metres.
    """

    normal: Vector3
    offset_m: float

    def heights_m(self, points: Points) -> Float32[np.ndarray, " n"]:
        """Signed heights above the plane, metres."""
        return points @ self.normal.astype(np.float32) + np.float32(self.offset_m)


def find_support_plane(
    points: Points,
    weights: Float32[np.ndarray, " n"],
    must_be_above: Float32[np.ndarray, "known 3"],
    up: Vector3 | None = None,
) -> SupportPlane | None:
    """Fit the support plane to points around the object; None where none is seen.

    The same points give the same plane: the hypotheses are drawn from a fixed seed.

    Args:
        points: Points around the object, camera frame, metres; a few thousand are plenty.
        weights: How near each is to the object, in [0, 1].
        must_be_above: Float32[np.ndarray, "known 3"] of the object, where they are known.
        up: Unit vector against gravity, or None where it is unknown. The plane's own normal comes back, not this.

    Source: Fischler and Bolles, "Random sample consensus", 1981; total least squares on the inliers.
    """
    if len(points) < MIN_INLIERS or float(weights.sum()) <= 0.0:
        return None
    planes = _hypotheses(points, weights, up)
    if planes.shape[1] == 0:
        return None
    # Kernels are compiled once more for every layout that arrays come in.
    best = _choose(points, weights, np.ascontiguousarray(must_be_above), planes)
    return None if best < 0 else _refine(points, weights, planes[:, best].astype(np.float64), up)


@compiled
def _choose(
    points: Points,
    weights: Float32[np.ndarray, " n"],
    must_be_above: Float32[np.ndarray, "known 3"],
    planes: Float32[np.ndarray, "normal_and_offset=4 k"],
) -> int:
    """Number of the plane with the best score; -1 where none is good enough."""
    # A fifth of the points is enough to tell the good hypotheses from the rest.
    rough, _ = _score(points, weights, must_be_above, planes, 5)
    finalists = np.argsort(rough)[-FINALISTS:]
    chosen = np.empty((4, len(finalists)), np.float32)
    for i in range(len(finalists)):
        chosen[:, i] = planes[:, finalists[i]]
    score, on = _score(points, weights, must_be_above, chosen, 1)
    best = np.argmax(score)
    return int(finalists[best]) if score[best] > 0.0 and on[best] >= MIN_SHARE else -1


@compiled
def _score(
    points: Points,
    weights: Float32[np.ndarray, " n"],
    must_be_above: Float32[np.ndarray, "known 3"],
    planes: Float32[np.ndarray, "normal_and_offset=4 k"],
    every: int,
) -> tuple[Float32[np.ndarray, " k"], Float32[np.ndarray, " k"]]:
    """Score of each plane, and the share of the weight that lies on it, from every so many-th point."""
    k = planes.shape[1]
    on, score = np.zeros(k, np.float32), np.zeros(k, np.float32)
    _weigh(points, weights, every, planes, on, score)
    for plane in range(k):
        score[plane] = on[plane] - score[plane]
    if len(must_be_above) > 0:
        even, unused, below = np.ones(len(must_be_above), np.float32), np.zeros(k, np.float32), np.zeros(k, np.float32)
        _weigh(must_be_above, even, every, planes, unused, below)
        for plane in range(k):
            score[plane] -= below[plane]
    return score, on


@compiled
def _weigh(
    points: Points,
    weights: Float32[np.ndarray, " n"],
    every: int,
    planes: Float32[np.ndarray, "normal_and_offset=4 k"],
    on: Float32[np.ndarray, " k"],
    below: Float32[np.ndarray, " k"],
) -> None:
    """Add up the weights of the points on each plane and of those below it, as shares of that of all."""
    nothing, all_weight = np.float32(0.0), 0.0
    for point in range(0, len(points), every):
        all_weight += weights[point]
    total = np.float32(all_weight)
    for point in range(0, len(points), every):
        x, y, z, weight = points[point, 0], points[point, 1], points[point, 2], weights[point] / total
        tolerance_m = plane_tolerance_m(z)
        for plane in range(planes.shape[1]):
            height_m = planes[0, plane] * x + planes[1, plane] * y + planes[2, plane] * z + planes[3, plane]
            on[plane] += weight if abs(height_m) < tolerance_m else nothing
            below[plane] += weight if height_m < np.float32(-2.0) * tolerance_m else nothing


def level_plane(plane: SupportPlane, up: Vector3, points: Points, weights: Float32[np.ndarray, " n"]) -> SupportPlane:
    """The same support with the given `up` as its normal where the two agree; else the plane as it is.

    The plane wins where they differ by more than `AGREEMENT_RAD`: the body is clamped to what it stands on.
    """
    if _angle_rad(plane.normal, up) > AGREEMENT_RAD:
        return plane
    normal, centre = plane.normal.astype(np.float32), np.zeros(3)
    average_inliers(points, weights, normal, np.float32(plane.offset_m), centre, np.zeros((3, 3)))
    return SupportPlane(up, -float(centre @ up))


def _hypotheses(
    points: Points, weights: Float32[np.ndarray, " n"], up: Vector3 | None
) -> Float32[np.ndarray, "normal_and_offset=4 k"]:
    """Planes through triples of points drawn by weight, with the camera above them; level ones too if `up` is known."""
    drawn, planes = np.empty((3, HYPOTHESES), np.int64), np.empty((4, HYPOTHESES))
    planes = planes[:, : _propose(points, weights, *_draws(), drawn, planes)]
    if up is not None:
        level = planes[:, up @ planes[:3] > math.cos(MAX_TILT_RAD)]
        heights = points[drawn[0, : HYPOTHESES // 2]] @ up
        upright = np.concatenate([np.broadcast_to(up[:, None], (3, len(heights))), -heights[None]])
        planes = np.concatenate([level, upright], axis=1)
    return planes.astype(np.float32, order="C")


@compiled
def _propose(
    points: Points,
    weights: Float32[np.ndarray, " n"],
    draws: Float64[np.ndarray, " draws"],
    places: Int64[np.ndarray, " draws"],
    drawn: Int64[np.ndarray, "corner=3 k"],
    planes: Float64[np.ndarray, "normal_and_offset=4 k"],
) -> int:
    """Planes through triples of points, the camera above each; how many there are, since three in a line make none.

    Each draw, a share of the weight of all, falls on a point; draws come in rising order, with their places. One walk
    along the points meets all draws: a search for each would wait for hundreds of wrongly guessed branches.
    """
    corners, cumulative, total = drawn.ravel(), np.empty(len(weights)), 0.0
    for point in range(len(weights)):
        total += np.float64(weights[point])
        cumulative[point] = total
    point, last = 0, len(weights) - 1
    for draw in range(len(draws)):
        wanted = draws[draw] * total
        while point < last and cumulative[point] < wanted:
            point += 1
        corners[places[draw]] = point
    found = 0
    for draw in range(drawn.shape[1]):
        first, second, third = drawn[0, draw], drawn[1, draw], drawn[2, draw]
        x, y, z = np.float64(points[first, 0]), np.float64(points[first, 1]), np.float64(points[first, 2])
        ax, ay, az = points[second, 0] - x, points[second, 1] - y, points[second, 2] - z
        bx, by, bz = points[third, 0] - x, points[third, 1] - y, points[third, 2] - z
        nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
        length = math.sqrt(nx * nx + ny * ny + nz * nz)
        if length > 1e-9:
            offset = -(nx * x + ny * y + nz * z) / length
            side = math.copysign(1.0 / length, offset)
            planes[0, found], planes[1, found], planes[2, found] = side * nx, side * ny, side * nz
            planes[3, found] = abs(offset)
            found += 1
    return found


@cache
def _draws() -> tuple[Float64[np.ndarray, " draws"], Int64[np.ndarray, " draws"]]:
    """Where in the points' cumulative weight the hypotheses take their three corners, in rising order, and whose it is.

    Always the same places; each stands for a corner and a hypothesis, corner by corner.
    """
    draws = np.random.default_rng(0).random(3 * HYPOTHESES)
    places = np.argsort(draws)
    draws = draws[places]
    draws.flags.writeable = places.flags.writeable = False
    return draws, places


def _refine(
    points: Points,
    weights: Float32[np.ndarray, " n"],
    plane: Float64[np.ndarray, "normal_and_offset=4"],
    up: Vector3 | None,
) -> SupportPlane | None:
    normal, centre = plane[:3].copy(), np.zeros(3)
    count, is_strip = settle(points, weights, normal, plane[3], centre, MIN_INLIERS)
    if count < MIN_INLIERS:
        return None
    if is_strip:
        return None if up is None else SupportPlane(up, -float(centre @ up))
    if up is not None and _angle_rad(normal, up) > MAX_TILT_RAD:
        return None
    return SupportPlane(normal, -float(normal @ centre))


def _angle_rad(a: Vector3, b: Vector3) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))
