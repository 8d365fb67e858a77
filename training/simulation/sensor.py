"""A depth sensor: what it adds to, and leaves out of, an ideal depth image.

Source of the noise: C. V. Nguyen, S. Izadi, D. Lovell, "Modeling Kinect sensor noise for improved 3D reconstruction
and tracking" (3DIMPVT 2012), with depth z in metres and θ the angle between ray and surface normal:

    axial    σ_z(z, θ) = 0.0012 + 0.0019 (z − 0.4)² + 0.0001/√z · θ²/(π/2 − θ)²   (metres)
    lateral  σ_L(θ)    = 0.8 + 0.035 θ/(π/2 − θ)                                  (pixels)

That paper measured the first Kinect; later cameras are steadier, so a factor scales both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Float32

from service.core.arrays import DepthImage, Mask

STEEPEST_RAD = math.radians(85)
"""θ beyond which the formulas, which have a pole at 90°, are held at their value here."""
JUMP = 0.025
"""Change of depth between neighbouring pixels, as a part of the depth, that makes an edge of an object."""


@dataclass(frozen=True)
class SensorModel:
    """How good a sensor is.

    Attributes:
        noise_scale: Factor on Nguyen's axial and lateral noise: 1 for the first Kinect, 0.2 to 0.6 for later cameras,
            0 for none.
        correlation_px: Width of the blur that neighbouring pixels' noise shares; stereo matching windows make it
            several pixels wide.
        quantum_m: Step of the readings: 0.001 where depth is stored as 16-bit millimetres; 0 for floats.
        disparity_quantum: Step of the disparity, z² · this in depth (1/m); 0 for none.
        edge_dropout: Chance that a pixel at a depth edge gives no reading.
        grazing_limit_rad: Angle between ray and normal from which readings begin to fail; all fail at 90°.
        flying_pixels: Chance that a pixel at a depth edge reads something between near and far.
        speckle_dropout: Chance of a single pixel without reading.
        holes: Mean number of blobs without reading.
        hole_radius_px: Largest radius of these blobs.
        nearest_m: Shortest range; nearer surfaces give no reading.
        farthest_m: Longest range.
        baseline_m: From the camera to its projector or second camera along x, of either sign: what the other one
            cannot see gives no reading, which puts a shadow beside each object. 0 for time of flight.
    """

    noise_scale: float = 0.5
    correlation_px: float = 1.0
    quantum_m: float = 0.001
    disparity_quantum: float = 0.0
    edge_dropout: float = 0.2
    grazing_limit_rad: float = math.radians(80)
    flying_pixels: float = 0.1
    speckle_dropout: float = 0.002
    holes: float = 2.0
    hole_radius_px: float = 6.0
    nearest_m: float = 0.15
    farthest_m: float = 6.0
    baseline_m: float = 0.0


PERFECT = SensorModel(0.0, 0.0, 0.0, 0.0, 0.0, math.pi / 2, 0.0, 0.0, 0.0, 0.0, 0.0, math.inf)
"""Adds nothing and drops nothing."""


def sample_sensor(rng: np.random.Generator) -> SensorModel:
    """A sensor from the range that robots carry, from an industrial scanner to a first Kinect."""
    return SensorModel(
        noise_scale=math.exp(rng.uniform(math.log(0.08), math.log(1.0))),
        correlation_px=rng.uniform(0.0, 2.5),
        quantum_m=0.001 if rng.random() < 0.7 else rng.choice([0.0001, 0.0]),
        disparity_quantum=0.0 if rng.random() < 0.6 else math.exp(rng.uniform(math.log(3e-4), math.log(2.5e-3))),
        edge_dropout=rng.uniform(0.0, 0.6),
        grazing_limit_rad=math.radians(rng.uniform(68, 85)),
        flying_pixels=rng.uniform(0.05, 0.35) if rng.random() < 0.4 else 0.0,
        speckle_dropout=0.01 * rng.random() ** 2,
        holes=float(rng.choice([0.0, 2.0, 6.0])),
        hole_radius_px=rng.uniform(3.0, 12.0),
        baseline_m=float(rng.choice([-1.0, 1.0])) * rng.uniform(0.02, 0.08) if rng.random() < 0.7 else 0.0,
    )


def apply_sensor(
    depth_m: DepthImage,
    rng: np.random.Generator,
    focal_px: float,
    model: SensorModel | None = None,
    holes_near: Mask | None = None,
) -> DepthImage:
    """What a sensor reads of an ideal depth image.

    Args:
        depth_m: Ideal depth, NaN where there is nothing.
        rng: Source of randomness; the same state gives the same image.
        focal_px: Focal length, for the angle at which a surface is seen.
        model: The sensor; one is drawn by `sample_sensor` if none is given.
        holes_near: Where most holes fall, such as the object's mask: a hole in the table teaches nothing.

    Returns:
        Depth in metres, NaN where there is no reading.
    """
    sensor = sample_sensor(rng) if model is None else model
    theta = incidence_rad(depth_m, focal_px)
    edge = depth_edges(depth_m)
    depth = _lateral(depth_m, theta, edge, rng, sensor)
    if sensor.flying_pixels > 0:
        depth = _fly(depth, edge, rng, sensor.flying_pixels)
    if sensor.noise_scale > 0:
        noise = _correlated_noise(depth.shape, rng, sensor.correlation_px)
        depth = depth + sensor.noise_scale * axial_sigma_m(depth, theta) * noise
    if sensor.disparity_quantum > 0:
        disparity = np.round(1 / depth / sensor.disparity_quantum) * sensor.disparity_quantum
        depth = 1 / np.maximum(disparity, sensor.disparity_quantum)
    if sensor.quantum_m > 0:
        depth = np.round(depth / sensor.quantum_m) * sensor.quantum_m
    lost = _dropout(depth.shape, theta, edge, rng, sensor)
    lost |= _holes(depth.shape, rng, sensor, holes_near)
    if sensor.baseline_m != 0:
        lost |= stereo_shadow(depth_m, focal_px * sensor.baseline_m)
    with np.errstate(invalid="ignore"):
        lost |= ~((depth >= sensor.nearest_m) & (depth <= sensor.farthest_m))
    return np.where(lost, np.nan, depth).astype(np.float32)


def axial_sigma_m(
    depth_m: Float32[np.ndarray, "height width"], theta_rad: Float32[np.ndarray, "height width"]
) -> Float32[np.ndarray, "height width"]:
    """Standard deviation of a reading along the ray, in metres.

    Source: Nguyen et al. 2012, equation 3 (its last term is the growth at grazing angles).
    """
    theta = np.minimum(theta_rad, STEEPEST_RAD)
    slope = theta / (np.float32(math.pi / 2) - theta)
    with np.errstate(invalid="ignore"):
        growth = np.float32(1e-4) / np.sqrt(depth_m) * slope * slope
    return np.asarray(0.0012 + 0.0019 * (depth_m - 0.4) ** 2 + growth, np.float32)


def lateral_sigma_px(theta_rad: Float32[np.ndarray, "height width"]) -> Float32[np.ndarray, "height width"]:
    """Standard deviation of where a reading was taken, in pixels. Source: Nguyen et al. 2012, equation 2."""
    theta = np.minimum(theta_rad, STEEPEST_RAD)
    return np.asarray(0.8 + 0.035 * theta / (math.pi / 2 - theta), np.float32)


def incidence_rad(depth_m: DepthImage, focal_px: float) -> Float32[np.ndarray, "height width"]:
    """Angle between the optical axis and the surface normal, from depth differences; 0 where there is no reading.

    On each axis the smaller of the two one-sided differences is taken, so that a depth edge does not pass for a steep
    surface on both of its sides.
    """
    padded = np.pad(depth_m, 1, mode="edge")
    slopes = []
    for ahead, back in ((padded[1:-1, 2:], padded[1:-1, :-2]), (padded[2:, 1:-1], padded[:-2, 1:-1])):
        forward, backward = np.abs(ahead - depth_m), np.abs(depth_m - back)
        slopes.append(np.fmin(forward, backward))
    with np.errstate(invalid="ignore", divide="ignore"):
        tangent = np.sqrt(slopes[0] ** 2 + slopes[1] ** 2) * np.float32(focal_px) / depth_m
    return np.asarray(np.arctan(np.nan_to_num(tangent)), np.float32)


def depth_edges(depth_m: DepthImage) -> Mask:
    """Pixels that differ from a neighbour by more than 2.5 % of their depth, or whose neighbour has no reading."""
    filled = np.nan_to_num(depth_m, nan=1e3).astype(np.float32)
    kernel = np.ones((3, 3), np.uint8)
    spread = cv2.dilate(filled, kernel) - cv2.erode(filled, kernel)
    return np.asarray((spread > JUMP * filled) & np.isfinite(depth_m), bool)


def stereo_shadow(depth_m: DepthImage, focal_baseline: float) -> Mask:
    """Pixels whose surface is hidden from a second camera on the same row.

    The second camera, `baseline` along +x, sees column u at s = u − focal·baseline/z. A surface is hidden where one
    farther along the row, nearer to the cameras, lands at the same s or before it.

    Args:
        depth_m: Ideal depth, NaN where there is nothing.
        focal_baseline: Focal length in pixels times the baseline in metres; negative for a second camera along −x.
    """
    if focal_baseline < 0:
        return np.ascontiguousarray(stereo_shadow(np.ascontiguousarray(depth_m[:, ::-1]), -focal_baseline)[:, ::-1])
    seen_at = np.arange(depth_m.shape[1], dtype=np.float32) - np.float32(focal_baseline) / depth_m
    seen_at = np.where(np.isfinite(seen_at), seen_at, np.inf)
    following = np.minimum.accumulate(seen_at[:, ::-1], axis=1)[:, ::-1]
    hidden = np.zeros(depth_m.shape, bool)
    # Half a pixel of grace: on a steep surface neighbours land at nearly the same place.
    hidden[:, :-1] = seen_at[:, :-1] > following[:, 1:] + 0.5
    return np.asarray(hidden & np.isfinite(depth_m), bool)


def _lateral(
    depth_m: DepthImage, theta: Float32[np.ndarray, "h w"], edge: Mask, rng: np.random.Generator, sensor: SensorModel
) -> DepthImage:
    """Read each pixel a little beside itself, which frays edges.

    On a smooth surface that would only add noise that the axial term holds already: it is done at edges.
    """
    if sensor.noise_scale == 0:
        return depth_m
    rows, columns = np.nonzero(cv2.dilate(edge.astype(np.uint8), np.ones((3, 3), np.uint8)))
    sigma = min(sensor.noise_scale, 1.0) * lateral_sigma_px(theta[rows, columns][:, None])[:, 0]
    jitter = np.rint(sigma * rng.standard_normal((2, len(rows)), np.float32)).astype(int)
    height, width = depth_m.shape
    moved = depth_m.copy()
    moved[rows, columns] = depth_m[
        np.clip(rows + jitter[0], 0, height - 1), np.clip(columns + jitter[1], 0, width - 1)
    ]
    return moved


def _fly(depth_m: DepthImage, edge: Mask, rng: np.random.Generator, chance: float) -> DepthImage:
    """Put some edge pixels between the surfaces on both sides, as time-of-flight cameras and resampling do."""
    kernel = np.ones((3, 3), np.uint8)
    near = cv2.erode(np.nan_to_num(depth_m, nan=1e3), kernel)
    rows, columns = np.nonzero(edge)
    chosen = (rng.random(len(rows), np.float32) < chance) & (near[rows, columns] < 1e3)
    rows, columns = rows[chosen], columns[chosen]
    far = cv2.dilate(np.nan_to_num(depth_m, nan=0.0), kernel)[rows, columns]
    flown, between = depth_m.copy(), near[rows, columns]
    flown[rows, columns] = between + rng.random(len(rows), np.float32) * np.maximum(far - between, 0)
    return flown


def _correlated_noise(
    shape: tuple[int, ...], rng: np.random.Generator, correlation_px: float
) -> Float32[np.ndarray, "h w"]:
    """Gaussian noise of unit deviation whose neighbours are alike over `correlation_px`."""
    noise = rng.standard_normal(shape, np.float32)
    if correlation_px < 0.3:
        return noise
    size = 2 * math.ceil(3 * correlation_px) + 1
    kernel = cv2.getGaussianKernel(size, correlation_px)
    # Blurring shrinks the deviation by the norm of the kernel on each axis.
    return np.asarray(cv2.sepFilter2D(noise, -1, kernel, kernel), np.float32) / np.float32((kernel**2).sum())


def _dropout(
    shape: tuple[int, ...],
    theta: Float32[np.ndarray, "h w"],
    edge: Mask,
    rng: np.random.Generator,
    sensor: SensorModel,
) -> Mask:
    """Pixels lost one by one: at random, at edges, and on surfaces seen at a grazing angle."""
    chance = np.full(shape, sensor.speckle_dropout, np.float32)
    chance[edge] = sensor.edge_dropout
    if sensor.grazing_limit_rad < math.pi / 2:
        grazing = (theta - sensor.grazing_limit_rad) / (math.pi / 2 - sensor.grazing_limit_rad)
        chance = np.maximum(chance, np.clip(grazing, 0, 1).astype(np.float32))
    return np.asarray(rng.random(shape, np.float32) < chance, bool)


def _holes(shape: tuple[int, ...], rng: np.random.Generator, sensor: SensorModel, near: Mask | None) -> Mask:
    """Ragged blobs without reading: specular, dark or transparent patches."""
    lost = np.zeros(shape, np.uint8)
    count = int(rng.poisson(sensor.holes))
    candidates = np.argwhere(near) if near is not None and near.any() else None
    for _ in range(count):
        if candidates is not None and rng.random() < 0.8:
            row, column = candidates[rng.integers(len(candidates))]
        else:
            row, column = rng.integers(shape[0]), rng.integers(shape[1])
        # A few overlapping discs make an outline less regular than one.
        for _ in range(int(rng.integers(1, 5))):
            radius = rng.uniform(1.0, max(sensor.hole_radius_px, 1.0))
            offset = rng.normal(0, 0.6 * radius, 2)
            cv2.circle(lost, (int(column + offset[0]), int(row + offset[1])), int(radius), 1, -1)
    return np.asarray(lost > 0, bool)
