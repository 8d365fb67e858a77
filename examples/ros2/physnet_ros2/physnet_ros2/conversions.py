"""What the node says in messages of ROS. No ROS is imported here: the classes of messages are handed in."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Mapping
from typing import Any

from service.client import Result
from service.client.ros import point_cloud_of, triangles_of

SURFACE, TRIANGLE_LIST, ADD = "deformed", 11, 0
"""Namespace, type and action of the marker (visualization_msgs/Marker)."""


def cloud_of(
    result: Result, header: Any, classes: Mapping[str, Callable[..., Any]],
    pack: Callable[[bytes], Any] = lambda raw: array("B", raw),
) -> Any:  # fmt: skip
    """The deformed body as PointCloud2: x, y, z and displacement, metres, camera frame."""
    return point_cloud_of(result, header, classes["PointCloud2"], classes["PointField"], pack)


def marker_of(result: Result, header: Any, classes: Mapping[str, Callable[..., Any]]) -> Any:
    """The deformed body's surface as a Marker of triangles, camera frame."""
    point, colour = classes["Point"], classes["ColorRGBA"]
    marker = classes["Marker"]()
    marker.header = header
    marker.ns, marker.id, marker.type, marker.action = SURFACE, 0, TRIANGLE_LIST, ADD
    marker.pose.orientation.w = 1.0
    marker.scale.x = marker.scale.y = marker.scale.z = 1.0
    marker.color = colour(r=0.2, g=0.6, b=0.55, a=0.8)
    marker.points = [point(x=x, y=y, z=z) for x, y, z in triangles_of(result).astype(float).tolist()]
    return marker


def material_of(given: Any) -> str | tuple[float, float]:
    """The parameter `material`: a name, or Young's modulus in Pa and Poisson's ratio as `1.2e5,0.45`."""
    text = str(given)
    if "," not in text:
        return text
    e_pa, nu = (float(part) for part in text.split(","))
    return e_pa, nu
