"""Points on a plane: how far off it they may lie, and the plane that is nearest to them."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float32

from service.core.arrays import Matrix3, Points, Vector3
from service.core.compiled import compiled

_ITERATIONS = 8
"""Leave 25⁻⁸ of what the normal was off."""

_THINNEST = 1e-12
"""Variance that any plane has, as a share of that along it."""


@compiled
def plane_tolerance_m(z_m: np.float32) -> np.float32:
    """How far a point of the support may lie off its plane: 3 mm, or 0.6 % of its depth where that is more.

    Structured light and stereo sensors err by 0.1–0.4 % of the depth at the ranges at which objects are handled, and
    tables are uneven by a millimetre or two.
    """
    shallow, deep = np.float32(0.003), np.float32(0.006) * z_m
    return shallow if shallow > deep else deep


@compiled
def average_inliers(
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


@compiled
def settle(
    points: Points, weights: Float32[np.ndarray, " n"], normal: Vector3, offset_m: float, centre: Vector3, least: int
) -> tuple[int, bool]:
    """Turn a plane to its inliers three times.

    Args:
        points: Camera frame, metres.
        weights: Of the points.
        normal: Of the plane, a unit vector; turned in its place.
        offset_m: Of the plane.
        centre: Weighted centre of the inliers, written.
        least: Fewer inliers end it.

    Returns:
        How many there are at last; whether they are a strip, which fixes a line, not a plane.
    """
    covariance, count = np.zeros((3, 3)), 0
    for _ in range(3):
        count = average_inliers(points, weights, normal.astype(np.float32), np.float32(offset_m), centre, covariance)
        if count < least:
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
