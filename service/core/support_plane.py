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
from jaxtyping import Float32, Float64

from service.core.arrays import Matrix3, Points, Vector3

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


def plane_tolerance_m(z_m: Float32[np.ndarray, "..."]) -> Float32[np.ndarray, "..."]:
    """How far a point of the support may lie off its plane: 3 mm, or 0.6 % of its depth where that is more.

    Structured light and stereo sensors err by 0.1–0.4 % of the depth at the ranges at which objects are handled, and
    tables are uneven by a millimetre or two.
    """
    return np.maximum(np.float32(0.003), np.float32(0.006) * z_m)


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
    normals, offsets = _hypotheses(points, weights, up)
    if len(normals) == 0:
        return None
    # A fifth of the points is enough to tell the good hypotheses from the rest.
    few = slice(None, None, 5)
    rough, _ = _score(points[few], weights[few], must_be_above[few], normals, offsets)
    finalists = np.argsort(rough)[-FINALISTS:]
    score, gain = _score(points, weights, must_be_above, normals[finalists], offsets[finalists])
    best = int(np.argmax(score))
    if score[best] <= 0.0 or gain[best] < MIN_SHARE:
        return None
    winner = int(finalists[best])
    return _refine(points, weights, normals[winner].astype(np.float64), float(offsets[winner]), up)


def _score(
    points: Points,
    weights: Float32[np.ndarray, " n"],
    must_be_above: Float32[np.ndarray, "known 3"],
    normals: Float32[np.ndarray, "k 3"],
    offsets: Float32[np.ndarray, " k"],
) -> tuple[Float32[np.ndarray, " k"], Float32[np.ndarray, " k"]]:
    """Score of each plane, and the share of the weight that lies on it."""
    share = weights / weights.sum()
    clearance = _clearance(points, normals, offsets)
    gain = (np.abs(clearance) < 1.0) @ share
    score = gain - (clearance < -2.0) @ share
    if len(must_be_above):
        score -= (_clearance(must_be_above, normals, offsets) < -2.0).mean(axis=1, dtype=np.float32)
    return score, gain


def _clearance(
    points: Points, normals: Float32[np.ndarray, "k 3"], offsets: Float32[np.ndarray, " k"]
) -> Float32[np.ndarray, "k n"]:
    """Height of each point above each plane in units of the plane's tolerance there."""
    inverse_tolerance = 1.0 / plane_tolerance_m(points[:, 2])
    scaled = np.empty((4, len(points)), np.float32)
    np.multiply(points.T, inverse_tolerance, out=scaled[:3])
    scaled[3] = inverse_tolerance
    return np.concatenate([normals, offsets[:, None]], axis=1) @ scaled


def level_plane(plane: SupportPlane, up: Vector3, points: Points, weights: Float32[np.ndarray, " n"]) -> SupportPlane:
    """The same support with the given `up` as its normal where the two agree; else the plane as it is.

    The plane wins where they differ by more than `AGREEMENT_RAD`: the body is clamped to what it stands on.
    """
    if _angle_rad(plane.normal, up) > AGREEMENT_RAD:
        return plane
    on_plane = np.abs(plane.heights_m(points)) < plane_tolerance_m(points[:, 2])
    along_up = points[on_plane].astype(np.float64) @ up
    return SupportPlane(up, -float(np.average(along_up, weights=weights[on_plane])))


def _hypotheses(
    points: Points, weights: Float32[np.ndarray, " n"], up: Vector3 | None
) -> tuple[Float32[np.ndarray, "k 3"], Float32[np.ndarray, " k"]]:
    """Planes through triples of points drawn by weight, with the camera above them; level ones too if `up` is known."""
    cumulative = np.cumsum(weights, dtype=np.float64)
    drawn = np.searchsorted(cumulative, _draws() * cumulative[-1])
    first, second, third = points[np.minimum(drawn, len(points) - 1)].astype(np.float64)
    normals = np.cross(second - first, third - first)
    length = np.linalg.norm(normals, axis=1)
    usable = length > 1e-9
    first, normals = first[usable], normals[usable] / length[usable, None]
    offsets = -(normals * first).sum(axis=1)
    normals *= np.where(offsets < 0.0, -1.0, 1.0)[:, None]
    offsets = np.abs(offsets)
    if up is not None:
        level = normals @ up > math.cos(MAX_TILT_RAD)
        heights = first[: HYPOTHESES // 2] @ up
        normals = np.concatenate([normals[level], np.broadcast_to(up, (len(heights), 3))])
        offsets = np.concatenate([offsets[level], -heights])
    return normals.astype(np.float32), offsets.astype(np.float32)


@cache
def _draws() -> Float64[np.ndarray, "corners=3 k"]:
    """Where in the points' cumulative weight each hypothesis takes its three: always the same places."""
    draws = np.random.default_rng(0).random((3, HYPOTHESES))
    draws.flags.writeable = False
    return draws


def _refine(
    points: Points,
    weights: Float32[np.ndarray, " n"],
    normal: Vector3,
    offset_m: float,
    up: Vector3 | None,
) -> SupportPlane | None:
    tolerance_m = plane_tolerance_m(points[:, 2])
    for _ in range(3):
        on_plane = np.abs(points @ normal.astype(np.float32) + np.float32(offset_m)) < tolerance_m
        if int(on_plane.sum()) < MIN_INLIERS:
            return None
        inliers = points[on_plane].astype(np.float64)
        inlier_weights = weights[on_plane].astype(np.float64)
        centre, spread, axes = _weighted_axes(inliers, inlier_weights)
        # A strip of points fixes a line, not a plane.
        if spread[1] < 5.0 * spread[0]:
            return None if up is None else SupportPlane(up, -float(np.average(inliers @ up, weights=inlier_weights)))
        normal = axes[:, 0] * (1.0 if float(axes[:, 0] @ normal) > 0.0 else -1.0)
        offset_m = -float(normal @ centre)
    if up is not None and _angle_rad(normal, up) > MAX_TILT_RAD:
        return None
    return SupportPlane(normal, offset_m)


def _weighted_axes(
    points: Float64[np.ndarray, "n 3"], weights: Float64[np.ndarray, " n"]
) -> tuple[Vector3, Vector3, Matrix3]:
    """Centre, standard deviations (ascending) and principal axes (columns) of weighted points."""
    centre = weights @ points / weights.sum()
    centred = points - centre
    variances, axes = np.linalg.eigh((centred * weights[:, None]).T @ centred / weights.sum())
    return centre, np.sqrt(np.maximum(variances, 0.0)), axes


def _angle_rad(a: Vector3, b: Vector3) -> float:
    return math.atan2(float(np.linalg.norm(np.cross(a, b))), float(a @ b))
