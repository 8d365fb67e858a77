"""The pinhole camera: rays through pixels, points from depth, and back.

Pixel (u, v) has its centre at integer coordinates, u to the right and v down, as in OpenCV and ROS. Points are in the
camera's optical frame (REP 103: x right, y down, z forward), metres.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Float32, Float64, Int64

from service.core.arrays import DepthImage, Mask, Points, Vector3
from service.core.errors import InvalidCamera, InvalidRequest

DISTORTION_LENGTHS = (4, 5, 8, 12, 14)
"""Numbers of coefficients that OpenCV's model knows: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [τx τy]]]]."""

UNDISTORTION_TOLERANCE_PX = 0.5
"""A pixel whose undistorted ray projects back farther off than this has no ray: the lens model folds over there."""

PIXEL_WINDOW_RADII = (1, 2, 4, 8, 16)
"""Windows tried in turn around a pixel without a reading; stereo holes on shiny objects reach a dozen pixels."""


@dataclass(frozen=True)
class Intrinsics:
    """A calibrated camera; build it with `make_intrinsics`, which checks it.

    Attributes:
        fx: Focal length along u in pixels, positive.
        fy: Focal length along v in pixels, positive.
        cx: Principal point, u in pixels.
        cy: Principal point, v in pixels.
        width: Image width in pixels.
        height: Image height in pixels.
        distortion: OpenCV's coefficients, or None where the image is rectified.
    """

    fx: float
    fy: float
    cx: float
    cy: float
    width: int
    height: int
    distortion: tuple[float, ...] | None = None

    @property
    def matrix(self) -> Float64[np.ndarray, "3 3"]:
        """The camera matrix K."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])


def make_intrinsics(
    fx: float,
    fy: float,
    cx: float,
    cy: float,
    width: int,
    height: int,
    distortion: Sequence[float] | None = None,
) -> Intrinsics:
    """Check a camera and build it. Distortion coefficients that are all zero count as none.

    Raises:
        InvalidCamera: A number is NaN or infinite, a focal length or a size is not positive, or the distortion has a
            number of coefficients that OpenCV's model does not know. `field` is such as `camera.fx`.
    """
    for name, focal in (("fx", fx), ("fy", fy)):
        if not math.isfinite(focal) or focal <= 0.0:
            raise InvalidCamera(
                f"The focal length {name} must be a positive number of pixels.",
                field=f"camera.{name}",
                expected="> 0",
                actual=_readable(focal),
            )
    for name, centre in (("cx", cx), ("cy", cy)):
        if not math.isfinite(centre):
            raise InvalidCamera(
                f"The principal point {name} must be a finite number of pixels.",
                field=f"camera.{name}",
                expected="finite",
                actual=_readable(centre),
            )
    for name, size in (("width", width), ("height", height)):
        if not math.isfinite(size) or size <= 0 or int(size) != size:
            raise InvalidCamera(
                f"The image {name} must be a positive whole number of pixels.",
                field=f"camera.{name}",
                expected="whole number > 0",
                actual=_readable(size),
            )
    coefficients = _check_distortion(distortion)
    return Intrinsics(float(fx), float(fy), float(cx), float(cy), int(width), int(height), coefficients)


def _check_distortion(distortion: Sequence[float] | None) -> tuple[float, ...] | None:
    if distortion is None or len(distortion) == 0:
        return None
    if len(distortion) not in DISTORTION_LENGTHS:
        raise InvalidCamera(
            "The distortion must have as many coefficients as one of OpenCV's models.",
            field="camera.distortion",
            expected=f"one of {', '.join(map(str, DISTORTION_LENGTHS))} coefficients",
            actual=len(distortion),
        )
    for index, coefficient in enumerate(distortion):
        if not math.isfinite(coefficient):
            raise InvalidCamera(
                "Distortion coefficients must be finite.",
                field=f"camera.distortion[{index}]",
                expected="finite",
                actual=_readable(coefficient),
            )
    if not any(distortion):
        return None
    return tuple(float(coefficient) for coefficient in distortion)


def _readable(number: int | float) -> int | float | str:
    """JSON has no NaN and no infinity, so a problem document spells them."""
    return number if math.isfinite(number) else str(number)


def parse_up(up: Sequence[float]) -> Vector3:
    """Unit vector against gravity in the camera frame, from a vector of any positive length.

    Raises:
        InvalidCamera: Not three finite numbers, or of zero length.
    """
    vector = np.asarray(up, np.float64)
    length = float(np.linalg.norm(vector)) if vector.shape == (3,) else math.nan
    # The threshold only keeps the division below meaningful; any real measurement is far above it.
    if not math.isfinite(length) or length < 1e-9:
        raise InvalidCamera(
            "`up` must be three finite numbers that are not all zero: the direction against gravity in the camera "
            "frame.",
            field="up",
            expected="3 finite numbers, length > 0",
            actual=", ".join(f"{component:g}" for component in vector.ravel()[:4]),
        )
    return np.asarray(vector / length, np.float64)


@lru_cache(maxsize=4)
def ray_grid(intrinsics: Intrinsics) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    """x/z and y/z of the ray through every pixel, with the lens distortion taken out; read-only.

    Cached: a camera keeps its intrinsics from frame to frame. Pixels that the lens model maps nowhere are NaN.

    Raises:
        InvalidCamera: The distortion cannot be undone at any pixel.
    """
    u = np.arange(intrinsics.width, dtype=np.float64)
    v = np.arange(intrinsics.height, dtype=np.float64)
    if intrinsics.distortion is None:
        shape = (intrinsics.height, intrinsics.width)
        ray_x = np.empty(shape, np.float32)
        ray_y = np.empty(shape, np.float32)
        ray_x[:] = (u - intrinsics.cx) / intrinsics.fx
        ray_y[:] = ((v - intrinsics.cy) / intrinsics.fy)[:, None]
    else:
        ray_x, ray_y = _undistorted_rays(intrinsics)
    ray_x.flags.writeable = False
    ray_y.flags.writeable = False
    return ray_x, ray_y


def _undistorted_rays(
    intrinsics: Intrinsics,
) -> tuple[Float32[np.ndarray, "height width"], Float32[np.ndarray, "height width"]]:
    shape = (intrinsics.height, intrinsics.width)
    v, u = np.indices(shape, dtype=np.float64)
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)
    coefficients = np.array(intrinsics.distortion)
    # OpenCV's default of five fixed-point steps leaves errors of pixels at the corners of wide lenses.
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-7)
    rays = cv2.undistortPoints(pixels[:, None], intrinsics.matrix, coefficients, criteria=criteria)[:, 0]
    points = np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
    with np.errstate(invalid="ignore", over="ignore"):
        error_px = np.abs(_distort(points, intrinsics) - pixels).max(axis=1)
        rays[~(error_px <= UNDISTORTION_TOLERANCE_PX)] = np.nan
    if not np.isfinite(rays).any():
        raise InvalidCamera(
            "The distortion coefficients cannot be undone at any pixel of this image.", field="camera.distortion"
        )
    return rays[:, 0].reshape(shape).astype(np.float32), rays[:, 1].reshape(shape).astype(np.float32)


def back_project(depth_m: DepthImage, intrinsics: Intrinsics, mask: Mask | None = None) -> Points:
    """Points of the pixels that have a reading (and lie in the mask), in row-major order of their pixels.

    Args:
        depth_m: Metres along the optical axis, NaN where there is no reading.
        intrinsics: The camera, of the same size as the image.
        mask: Pixels to take; all where None.

    Returns:
        n points (x, y, z) in the camera frame, metres.

    Source: pinhole model, x = (u − cx)/fx · z, y = (v − cy)/fy · z.
    """
    usable = np.isfinite(depth_m) if mask is None else np.isfinite(depth_m) & mask
    points = back_project_pixels(np.flatnonzero(usable), depth_m, intrinsics)
    if intrinsics.distortion is not None:
        points = points[np.isfinite(points[:, 0])]
    return points


def back_project_pixels(pixels: Int64[np.ndarray, " n"], depth_m: DepthImage, intrinsics: Intrinsics) -> Points:
    """Points of pixels given by their flat (row-major) index, one for one; NaN where there is no reading or no ray."""
    ray_x, ray_y = ray_grid(intrinsics)
    points = np.empty((len(pixels), 3), np.float32)
    z = depth_m.ravel()[pixels]
    np.multiply(ray_x.ravel()[pixels], z, out=points[:, 0])
    np.multiply(ray_y.ravel()[pixels], z, out=points[:, 1])
    points[:, 2] = z
    return points


def project(points: Points, intrinsics: Intrinsics) -> tuple[Float64[np.ndarray, "n 2"], Float64[np.ndarray, " n"]]:
    """Pixels (u, v) where points appear, and their depth in metres; NaN pixels for points not in front of the camera.

    Source: pinhole model with OpenCV's distortion, the inverse of `back_project`.
    """
    points_m = points.astype(np.float64)
    z_m = points_m[:, 2]
    in_front = z_m > 0.0
    pixels = np.full((len(points_m), 2), np.nan)
    pixels[in_front] = _distort(points_m[in_front], intrinsics)
    return pixels, z_m


def _distort(points: Float64[np.ndarray, "n 3"], intrinsics: Intrinsics) -> Float64[np.ndarray, "n 2"]:
    if intrinsics.distortion is None:
        inverse_z = 1.0 / points[:, 2]
        u = intrinsics.fx * points[:, 0] * inverse_z + intrinsics.cx
        v = intrinsics.fy * points[:, 1] * inverse_z + intrinsics.cy
        return np.stack([u, v], axis=1)
    if len(points) == 0:
        return np.empty((0, 2))
    nothing = np.zeros(3)
    pixels, _ = cv2.projectPoints(points, nothing, nothing, intrinsics.matrix, np.array(intrinsics.distortion))
    return np.asarray(pixels[:, 0], np.float64)


def pixel_to_point(
    u: float,
    v: float,
    depth_m: DepthImage,
    intrinsics: Intrinsics,
    *,
    mask: Mask | None = None,
    corner_px: tuple[int, int] = (0, 0),
    field: str = "contact_px",
) -> Vector3:
    """The surface point seen at a pixel, camera frame, metres.

    Where the pixel has no reading, the median depth of the smallest window around it that holds three readings
    stands in for it, on the ray of the pixel itself.

    Args:
        u: Column, may lie between pixels.
        v: Row, may lie between pixels.
        depth_m: Metres, NaN where there is no reading.
        intrinsics: The camera.
        mask: Pixels that may be read, such as those of the object; all where None.
        corner_px: (u, v) of the first reading where there are those of a window only, in which the pixel must lie.
        field: Path of the pixel in the request, for the error.

    Raises:
        InvalidRequest: The pixel lies outside the image, or no reading is near it.
    """
    inside = math.isfinite(u) and math.isfinite(v)
    column, row = (math.floor(u + 0.5), math.floor(v + 0.5)) if inside else (-1, -1)
    if not (0 <= column < intrinsics.width and 0 <= row < intrinsics.height):
        raise InvalidRequest(
            "The contact pixel lies outside the image.",
            field=field,
            expected=f"u in [0, {intrinsics.width - 1}], v in [0, {intrinsics.height - 1}]",
            actual=f"({u:g}, {v:g})",
        )
    z_m = _depth_near(column - corner_px[0], row - corner_px[1], depth_m, mask)
    if z_m is None:
        raise InvalidRequest(
            "The depth image has no reading near the contact pixel; name another pixel or send `contact_m`.",
            field=field,
            expected=f"a reading within {PIXEL_WINDOW_RADII[-1]} pixels",
            actual=f"({u:g}, {v:g})",
        )
    if intrinsics.distortion is None:
        ray_x, ray_y = (u - intrinsics.cx) / intrinsics.fx, (v - intrinsics.cy) / intrinsics.fy
    else:
        grid_x, grid_y = ray_grid(intrinsics)
        ray_x, ray_y = float(grid_x[row, column]), float(grid_y[row, column])
    if not math.isfinite(ray_x):
        raise InvalidRequest("The lens distortion cannot be undone at the contact pixel.", field=field)
    return np.array([ray_x * z_m, ray_y * z_m, z_m])


def _depth_near(column: int, row: int, depth_m: DepthImage, mask: Mask | None) -> float | None:
    if 0 <= row < depth_m.shape[0] and 0 <= column < depth_m.shape[1] and (mask is None or mask[row, column]):
        if math.isfinite(z_m := float(depth_m[row, column])):
            return z_m
    for radius in PIXEL_WINDOW_RADII:
        window = (slice(max(row - radius, 0), row + radius + 1), slice(max(column - radius, 0), column + radius + 1))
        readings = depth_m[window] if mask is None else depth_m[window][mask[window]]
        readings = readings[np.isfinite(readings)]
        if len(readings) >= 3:
            return float(np.median(readings))
    return None
