"""Between ROS messages and the client's types, without ROS: any object with the fields of a message will do.

`rclpy`, the type stores of `rosbags` and the decoders of `mcap` all give such objects; stamps are those of ROS 2
(`sec`, `nanosec`), fields of CameraInfo those of ROS 2 or ROS 1 (`k`, `d` or `K`, `D`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from service.client.question import Camera, Image
from service.client.result import Layer, Result
from service.core.arrays import Matrix3, Points

DEPTH_TYPES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
INFO_TYPE = "sensor_msgs/msg/CameraInfo"
TF_TYPES = ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage")

_RAW = {"16UC1": "u2", "mono16": "u2", "32FC1": "f4"}
_FLOAT32 = 7  # of sensor_msgs/PointField
_LENSES = ("", "plumb_bob", "rational_polynomial", "none")


def stamp_ns(header: Any) -> int:
    """Nanoseconds of a header's stamp."""
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def depth_of(message: Any) -> Image:
    """A depth image from `sensor_msgs/Image` (16UC1, 32FC1) or `sensor_msgs/CompressedImage`.

    Raw rows lose their padding and become little-endian. A compressedDepth payload goes as it is, for the service to
    decode: on the robot's side that costs nothing.

    Raises:
        ValueError: The message is no depth image, or its rows are shorter than its width.
    """
    if hasattr(message, "format"):
        kind = str(message.format)
        if "compressedDepth" in kind:
            return Image(kind, bytes(message.data))
        if "png" in kind and "16" in kind:
            return Image("png16", bytes(message.data))
        raise ValueError(f"a CompressedImage of format {kind!r} is no depth image")
    if message.encoding not in _RAW:
        raise ValueError(f"an Image of encoding {message.encoding!r} is no depth image: 16UC1 or 32FC1")
    kind = _RAW[message.encoding]
    rows = np.frombuffer(bytes(message.data), np.uint8).reshape(message.height, -1)
    row_bytes = message.width * int(kind[1])
    if rows.shape[1] != message.step or message.step < row_bytes:
        raise ValueError(f"an Image of width {message.width} has rows of {message.step} bytes")
    pixels = np.ascontiguousarray(rows[:, :row_bytes]).view((">" if message.is_bigendian else "<") + kind)
    encoding = "32FC1" if kind == "f4" else "16UC1"
    return Image(encoding, pixels.astype("<" + kind, copy=False).tobytes())


def camera_of(info: Any) -> Camera:
    """Intrinsics from `sensor_msgs/CameraInfo`, of the image as it was sent: binning and region of interest applied.

    Raises:
        ValueError: The camera is not calibrated, or its lens is no pinhole with OpenCV's distortion.
    """
    if info.distortion_model not in _LENSES:
        raise ValueError(f"a lens of model {info.distortion_model!r} is not supported: rectify the image")
    fx, _, cx, _, fy, cy, *_ = (float(number) for number in getattr(info, "k", getattr(info, "K", ())))
    if fx == 0.0:
        raise ValueError("the camera is not calibrated: its CameraInfo has fx = 0")
    distortion = tuple(float(number) for number in getattr(info, "d", getattr(info, "D", ())))
    across, down = (max(1, int(getattr(info, f"binning_{axis}", 0))) for axis in "xy")
    roi = info.roi
    cut = roi.width > 0 and roi.height > 0
    left, top = (roi.x_offset, roi.y_offset) if cut else (0, 0)
    width, height = (roi.width, roi.height) if cut else (info.width, info.height)
    return Camera(
        fx=fx / across,
        fy=fy / down,
        # A binned pixel's centre lies between those of its parts.
        cx=(cx - left + 0.5) / across - 0.5,
        cy=(cy - top + 0.5) / down - 0.5,
        width=int(width) // across,
        height=int(height) // down,
        distortion=distortion if any(distortion) else (),
    )


def rotation_of(quaternion: Any) -> Matrix3:
    """Rotation matrix of a quaternion (`x y z w`), which need not be of length 1.

    Raises:
        ValueError: Its length is 0.

    Source: Shoemake, Animating rotation with quaternion curves, SIGGRAPH 1985.
    """
    x, y, z, w = (float(getattr(quaternion, name)) for name in "xyzw")
    length = x * x + y * y + z * z + w * w
    if length == 0.0:
        raise ValueError("a rotation by a quaternion of length 0")
    s = 2.0 / length
    return np.array(
        [
            [1 - s * (y * y + z * z), s * (x * y - z * w), s * (x * z + y * w)],
            [s * (x * y + z * w), 1 - s * (x * x + z * z), s * (y * z - x * w)],
            [s * (x * z - y * w), s * (y * z + x * w), 1 - s * (x * x + y * y)],
        ]
    )


def point_cloud_of(
    result: Result, header: Any, cloud: Callable[..., Any], field: Callable[..., Any],
    pack: Callable[[bytes], Any], layer: Layer = "deformed", push: int = 0,
) -> Any:  # fmt: skip
    """`sensor_msgs/PointCloud2` of a body's voxels: `x y z`, and `displacement` in metres where it is known.

    Args:
        result: The answer.
        header: Of the frame it is about.
        cloud: The class `PointCloud2`.
        field: The class `PointField`.
        pack: From bytes to what the class takes for `data`: `array.array("B", …)` for rclpy.
        layer: Which body.
        push: After which push.
    """
    names = ["x", "y", "z"]
    columns: list[np.ndarray] = [result.points_camera(layer, push)]
    if layer == "deformed" and result[push].displacement is not None:
        names.append("displacement")
        columns.append(voxel_displacements_m(result, push)[:, None])
    rows = np.ascontiguousarray(np.hstack(columns), "<f4")
    step = rows.shape[1] * 4
    return cloud(
        header=header,
        height=1,
        width=len(rows),
        fields=[field(name=name, offset=4 * place, datatype=_FLOAT32, count=1) for place, name in enumerate(names)],
        is_bigendian=False,
        point_step=step,
        row_step=step * len(rows),
        data=pack(rows.tobytes()),
        is_dense=True,
    )


def triangles_of(result: Result, layer: Layer = "deformed", push: int = 0) -> Points:
    """Corners of a surface's triangles, three after three, camera frame, metres: points of a TRIANGLE_LIST marker."""
    mesh = result.mesh(layer, push)
    return np.asarray(mesh.vertices_m[mesh.faces.ravel()])


def voxel_displacements_m(result: Result, push: int = 0) -> np.ndarray:
    """How far the material at each voxel of the deformed body has come, in the order of `points_camera`."""
    return np.asarray(np.linalg.norm(result[push].moved_m.astype(np.float32), axis=0))
