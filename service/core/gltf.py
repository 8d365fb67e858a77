"""Surfaces as one binary glTF 2.0 file, which viewers and modelling programs open.

Source: Khronos, glTF 2.0 specification: GLB layout (4.4), accessors (3.6.2), vertex colours in linear light (3.7.2.1).
"""

from __future__ import annotations

import json
import struct
from typing import Any

import numpy as np
from jaxtyping import UInt8

from service.core.arrays import Points
from service.core.surface_mesh import Faces, vertex_normals

_FLOAT, _UINT8, _UINT32 = 5126, 5121, 5125
_VERTICES, _INDICES = 34962, 34963

_MATERIALS = [
    {
        "name": "before",
        "pbrMetallicRoughness": {"baseColorFactor": [0.45, 0.5, 0.55, 0.3], "metallicFactor": 0.0},
        "alphaMode": "BLEND",
    },
    {"name": "after", "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 0.8}},
]


class GltfFile:
    """A glTF document and its one buffer, as they grow."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []
        self._length = 0
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []
        self._nodes: list[dict[str, Any]] = []

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
        node: dict[str, Any] = {"name": name, "extras": extras or {}}
        self._nodes.append(node)
        if len(faces) == 0:
            return
        attributes = {
            "POSITION": self._accessor(
                vertices_m, _FLOAT, "VEC3", min=vertices_m.min(axis=0).tolist(), max=vertices_m.max(axis=0).tolist()
            ),
            "NORMAL": self._accessor(vertex_normals(vertices_m, faces), _FLOAT, "VEC3"),
        }
        if colours is not None:
            attributes["COLOR_0"] = self._accessor(_linear(colours), _UINT8, "VEC4", normalized=True)
        indices = self._accessor(faces.astype(np.uint32).reshape(-1, 1), _UINT32, "SCALAR", target=_INDICES)
        node["mesh"] = len(self._meshes)
        material = 0 if colours is None else 1
        primitive = {"attributes": attributes, "indices": indices, "material": material}
        self._meshes.append({"name": name, "primitives": [primitive]})

    def _accessor(self, array: np.ndarray, component: int, kind: str, target: int = _VERTICES, **more: Any) -> int:
        # Every element is 4, 12 or 16 bytes long, so that all views begin at multiples of four as they must.
        data = np.ascontiguousarray(array).tobytes()
        self._views.append({"buffer": 0, "byteOffset": self._length, "byteLength": len(data), "target": target})
        self._chunks.append(data)
        self._length += len(data)
        self._accessors.append(
            {"bufferView": len(self._views) - 1, "componentType": component, "count": len(array), "type": kind, **more}
        )
        return len(self._accessors) - 1

    def encode(self, extras: dict[str, Any]) -> bytes:
        """The whole file; `extras` are those of the scene."""
        document: dict[str, Any] = {
            "asset": {"version": "2.0", "generator": "PhysNet"},
            "scene": 0,
            "scenes": [{"name": "PhysNet", "nodes": list(range(len(self._nodes))), "extras": extras}],
            "nodes": self._nodes,
        }
        if self._meshes:
            document |= {
                "meshes": self._meshes,
                "materials": _MATERIALS,
                "accessors": self._accessors,
                "bufferViews": self._views,
                "buffers": [{"byteLength": self._length}],
            }
        text = json.dumps(document, separators=(",", ":"), allow_nan=False).encode()
        text += b" " * (-len(text) % 4)
        chunks = [struct.pack("<I4s", len(text), b"JSON"), text]
        if self._meshes:
            chunks += [struct.pack("<I4s", self._length, b"BIN\0"), *self._chunks]
        return struct.pack("<4sII", b"glTF", 2, 12 + sum(map(len, chunks))) + b"".join(chunks)


def _linear(colours: UInt8[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "n 4"]:
    """In linear light, opaque.

    Source: IEC 61966-2-1 (sRGB), the inverse transfer function.
    """
    seen = colours / 255.0
    linear = np.where(seen <= 0.04045, seen / 12.92, ((seen + 0.055) / 1.055) ** 2.4)
    opaque = np.full((len(colours), 4), 255, np.uint8)
    opaque[:, :3] = np.rint(255.0 * linear)
    return opaque
