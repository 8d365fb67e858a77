"""Binary PLY: a surface with how far each of its vertices has moved.

Source: Turk, The PLY Polygon File Format (1994).
"""

from __future__ import annotations

import numpy as np

from service.core.arrays import Points
from service.core.surface_mesh import Faces


def encode_ply(vertices_m: Points, faces: Faces, displacement_m: Points | None = None) -> bytes:
    """A little-endian PLY file: vertices `x y z`, with a field also `dx dy dz`, all metres; triangles."""
    names = ["x", "y", "z"]
    columns = [np.asarray(vertices_m, np.float32)]
    if displacement_m is not None:
        names += ["dx", "dy", "dz"]
        columns.append(np.asarray(displacement_m, np.float32))
    properties = "".join(f"property float {name}\n" for name in names)
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment metres, camera frame: x right, y down, z forward\n"
        f"element vertex {len(vertices_m)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    triangles = np.empty(len(faces), np.dtype([("count", "u1"), ("indices", "<i4", (3,))]))
    triangles["count"] = 3
    triangles["indices"] = faces
    vertices = np.ascontiguousarray(np.hstack(columns), "<f4")
    return header.encode("ascii") + vertices.tobytes() + triangles.tobytes()
