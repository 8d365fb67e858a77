"""Binary PLY: a surface with how far each of its vertices has moved. trimesh writes it (plyfile is under the GPL)."""

from __future__ import annotations

import numpy as np

from service.core.arrays import Points
from service.core.surface_mesh import Faces

_FRAME = b"comment metres, camera frame: x right, y down, z forward\n"


def encode_ply(vertices_m: Points, faces: Faces, displacement_m: Points | None = None) -> bytes:
    """A little-endian PLY file: vertices `x y z`, with a field also `dx dy dz`, all float32 metres; triangles."""
    # Imported where it is used: 0.1 s, and 1 s where SciPy is there, which only those wait who want such a file.
    from trimesh import Trimesh
    from trimesh.exchange.ply import export_ply

    mesh = Trimesh(vertices_m, faces, process=False)
    if displacement_m is not None:
        columns = np.asarray(displacement_m, np.float32).T
        mesh.vertex_attributes.update(zip(("dx", "dy", "dz"), columns, strict=True))
    # trimesh takes no comments.
    return bytes(export_ply(mesh, vertex_normal=False)).replace(b"element vertex", _FRAME + b"element vertex", 1)
