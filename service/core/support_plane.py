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

from service.core.arrays import Matrix3, Points, Vector3
from service.core.compiled import compiled

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


_ITERATIONS = 8
"""Leave 25⁻⁸ of what the normal was off."""

_THINNEST = 1e-12
"""Variance that any plane has, as a share of that along it."""


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


@compiled
def plane_tolerance_m(z_m: np.float32) -> np.float32:
    """How far a point of the support may lie off its plane: 3 mm, or 0.6 % of its depth where that is more.

    Structured light and stereo sensors err by 0.1–0.4 % of the depth at the ranges at which objects are handled, and
    tables are uneven by a millimetre or two.
    """
    shallow, deep = np.float32(0.003), np.float32(0.006) * z_m
    return shallow if shallow > deep else deep


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
    centre = np.zeros(3)
    _average(points, weights, plane.normal.astype(np.float32), np.float32(plane.offset_m), centre, np.zeros((3, 3)))
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


@compiled
def _average(
    points: Points,
    weights: Float32[np.ndarray, " n"],
    normal: Float32[np.ndarray, "3"],
    offset_m: np.float32,
    centre: Vector3,
    covariance: Matrix3,
) -> int:
    """Weighted centre and covariance of the points on a plane, how many there are; zeros stay where there are none."""
    count, total = 0, 0.0
    x_sum = y_sum = z_sum = xx = xy = xz = yy = yz = zz = 0.0  # variables, since sums in arrays wait for the memory
    for point in range(len(points)):
        x, y, z = np.float64(points[point, 0]), np.float64(points[point, 1]), np.float64(points[point, 2])
        height_m = normal[0] * points[point, 0] + normal[1] * points[point, 1] + normal[2] * points[point, 2] + offset_m
        if abs(height_m) < plane_tolerance_m(points[point, 2]):
            count += 1
            weight = np.float64(weights[point])
            total += weight
            x_sum, y_sum, z_sum = x_sum + weight * x, y_sum + weight * y, z_sum + weight * z
            xx, xy, xz = xx + weight * x * x, xy + weight * x * y, xz + weight * x * z
            yy, yz, zz = yy + weight * y * y, yz + weight * y * z, zz + weight * z * z
    if count > 0:
        mean_x, mean_y, mean_z = x_sum / total, y_sum / total, z_sum / total
        centre[0], centre[1], centre[2] = mean_x, mean_y, mean_z
        covariance[0, 0], covariance[1, 1] = xx / total - mean_x * mean_x, yy / total - mean_y * mean_y
        covariance[2, 2] = zz / total - mean_z * mean_z
        covariance[0, 1] = covariance[1, 0] = xy / total - mean_x * mean_y
        covariance[0, 2] = covariance[2, 0] = xz / total - mean_x * mean_z
        covariance[1, 2] = covariance[2, 1] = yz / total - mean_y * mean_z
    return count


def _refine(
    points: Points,
    weights: Float32[np.ndarray, " n"],
    plane: Float64[np.ndarray, "normal_and_offset=4"],
    up: Vector3 | None,
) -> SupportPlane | None:
    normal, centre = plane[:3].copy(), np.zeros(3)
    count, is_strip = _settle(points, weights, normal, plane[3], centre)
    if count < MIN_INLIERS:
        return None
    if is_strip:
        return None if up is None else SupportPlane(up, -float(centre @ up))
    if up is not None and _angle_rad(normal, up) > MAX_TILT_RAD:
        return None
    return SupportPlane(normal, -float(normal @ centre))


@compiled
def _settle(
    points: Points, weights: Float32[np.ndarray, " n"], normal: Vector3, offset_m: float, centre: Vector3
) -> tuple[int, bool]:
    """Turn a plane to its inliers three times.

    Returns:
        How many there are at last; whether they are a strip, which fixes a line, not a plane.
    """
    covariance, count = np.zeros((3, 3)), 0
    for _ in range(3):
        count = _average(points, weights, normal.astype(np.float32), np.float32(offset_m), centre, covariance)
        if count < MIN_INLIERS:
            break
        if not _turn_to_least(covariance, normal):
            return count, True
        offset_m = -(normal[0] * centre[0] + normal[1] * centre[1] + normal[2] * centre[2])
    return count, False


@compiled
def _turn_to_least(covariance: Matrix3, normal: Vector3) -> bool:
    """Turn a unit vector to the axis of the least variance, on its own side; whether the points are no strip.

    A strip is less than five times as wide as thick. Of what is wider, the inverse shrinks every other part of the
    vector by 25 at least.

    Source: inverse iteration; Golub and Van Loan, "Matrix Computations", 8.2.2.
    """
    # Planes without any thickness have no inverse.
    trace = covariance[0, 0] + covariance[1, 1] + covariance[2, 2]
    a, b, c = covariance[0, 0] + _THINNEST * trace, covariance[0, 1], covariance[0, 2]
    d, e, f = covariance[1, 1] + _THINNEST * trace, covariance[1, 2], covariance[2, 2] + _THINNEST * trace
    aa, bb, cc, dd, ee, ff = d * f - e * e, c * e - b * f, b * e - c * d, a * f - c * c, b * c - a * e, a * d - b * b
    before_x, before_y, before_z = normal[0], normal[1], normal[2]
    x, y, z = before_x, before_y, before_z
    for _ in range(_ITERATIONS):
        x, y, z = aa * x + bb * y + cc * z, bb * x + dd * y + ee * z, cc * x + ee * y + ff * z
        length = math.sqrt(x * x + y * y + z * z)
        if not length > 0.0:
            return False  # a line, or a point
        x, y, z = x / length, y / length, z / length
    side = -1.0 if x * before_x + y * before_y + z * before_z < 0.0 else 1.0
    normal[0], normal[1], normal[2] = side * x, side * y, side * z
    # Of the other two variances sum and product are known.
    least = x * (a * x + b * y + c * z) + y * (b * x + d * y + e * z) + z * (c * x + e * y + f * z)
    half, product = 0.5 * (a + d + f - least), aa + dd + ff - least * (a + d + f - least)
    middle = half - math.sqrt(max(half * half - product, 0.0))
    return bool(middle >= 25.0 * least)


def _angle_rad(a: Vector3, b: Vector3) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))
