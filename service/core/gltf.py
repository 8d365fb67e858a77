"""Surfaces as one binary glTF 2.0 file, which viewers and modelling programs open. trimesh writes it.

pygltflib, which was looked at as well, packs the file alone: accessors, views and their bounds would stay here.

Source: Khronos, glTF 2.0 specification: vertex colours in linear light (3.7.2.1).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import UInt8

from service.core.arrays import Points
from service.core.surface_mesh import Faces, vertex_normals

_BEFORE = {"name": "before", "baseColorFactor": [0.45, 0.5, 0.55, 0.3], "metallicFactor": 0.0, "alphaMode": "BLEND"}
_AFTER = {"name": "after", "metallicFactor": 0.0, "roughnessFactor": 0.8}


class GltfFile:
    """A scene as it grows."""

    def __init__(self) -> None:
        # Imported where it is used: 0.1 s, and 1 s where SciPy is there, which only those wait who want such a file.
        import trimesh

        self._scene = trimesh.Scene()

    def add(
        self,
        name: str,
        vertices_m: Points,
        faces: Faces,
        colours: UInt8[np.ndarray, "n 3"] | None = None,
        extras: dict[str, Any] | None = None,
    ) -> None:
        """A node and its mesh; without a mesh where there is no surface, which glTF cannot say otherwise.

        Args:
            name: Of the node.
            vertices_m: In the frame of the scene.
            faces: Triangles.
            colours: Of each vertex, as screens show them; translucent grey without.
            extras: What the node says of itself beside.
        """
        from trimesh import Trimesh
        from trimesh.visual import TextureVisuals
        from trimesh.visual.material import PBRMaterial

        if len(faces) == 0:
            self._scene.graph.update(frame_to=name, matrix=np.eye(4), metadata=extras)
            return
        visual = TextureVisuals(material=PBRMaterial(**(_BEFORE if colours is None else _AFTER)))
        if colours is not None:
            visual.vertex_attributes["color"] = _linear(colours)
        normals = vertex_normals(vertices_m, faces)
        mesh = Trimesh(vertices_m, faces, vertex_normals=normals, visual=visual, process=False)
        self._scene.add_geometry(mesh, node_name=name, geom_name=name, metadata=extras)

    def encode(self, extras: dict[str, Any]) -> bytes:
        """The whole file; `extras` are those of the scene."""
        from trimesh.exchange.gltf import export_glb

        self._scene.metadata.update(extras)
        # The normals are of unit length as they are.
        return bytes(export_glb(self._scene, include_normals=True, unitize_normals=False))


def _linear(colours: UInt8[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n 4"]:
    """In linear light, opaque.

    Source: IEC 61966-2-1 (sRGB), the inverse transfer function.
    """
    seen = colours / 255.0
    linear = np.where(seen <= 0.04045, seen / 12.92, ((seen + 0.055) / 1.055) ** 2.4)
    opaque = np.full((len(colours), 4), 255, np.uint8)
    opaque[:, :3] = np.rint(255.0 * linear)
    return opaque
