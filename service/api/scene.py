"""An answer as one binary glTF 2.0 scene, which viewers and modelling programs open.

Source: Khronos, glTF 2.0 specification: GLB layout (4.4), accessors (3.6.2), vertex colours in linear light (3.7.2.1).
"""

from __future__ import annotations

import json
import struct
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

from service.core.arrays import GRID_SIZE, Points
from service.core.grids import Grid, invert_rigid, transform_points
from service.core.messages import DeformResult, LoadResult
from service.core.surface_mesh import surface_mesh, vertex_normals

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


def scene_glb(result: DeformResult) -> bytes:
    """The surfaces before and after each load.

    Metres in the camera's optical frame, whose y points down: nodes carry no transform. Node `reconstruction` is
    translucent; node `load <i>` is coloured by the length of the displacement, from none (dark) to the largest of all
    loads (yellow). `extras` of a node hold its numbers, those of the scene the pose of the grid.
    """
    grid = result.grid
    file = _File()
    surface = surface_mesh(result.reconstruction, grid.camera_from_grid, grid.pitch_m)
    file.add("reconstruction", *surface, None, 0, {"flags": sorted(result.flags)})
    largest_m = max((load.max_displacement_m for load in result.loads), default=0.0)
    for number, load in enumerate(result.loads):
        vertices, faces = surface_mesh(load.deformed, grid.camera_from_grid, grid.pitch_m)
        lengths_m = displacement_at_surface(load, grid, vertices)
        extras = {
            "max_displacement_m": load.max_displacement_m,
            "mean_displacement_m": load.mean_displacement_m,
            "load_number": load.load_number,
            "flags": sorted(load.flags),
        }
        file.add(f"load {number}", vertices, faces, _colours(lengths_m, largest_m), 1, extras)
    return file.encode(
        {
            "frame": "camera optical frame: x right, y down, z forward; metres",
            "model": {"name": result.model_name, "version": result.model_version},
            "reconstruction_id": result.reconstruction_id,
            "voxel_size_m": grid.pitch_m,
            "camera_from_grid": grid.camera_from_grid.tolist(),
            "largest_displacement_m": largest_m,
        }
    )


def displacement_at_surface(load: LoadResult, grid: Grid, vertices: Points) -> Float32[np.ndarray, " n"]:
    """Length of the displacement at points of the deformed body's surface (camera frame), metres.

    The surface passes between voxels of which some are outside, where there is no displacement: the largest of the
    eight around a point stands for it.
    """
    lengths_m = np.pad(np.sqrt((load.displacement_m**2).sum(axis=0)), 1)
    in_grid = transform_points(invert_rigid(grid.camera_from_grid), vertices) / np.float32(grid.pitch_m)
    cells = np.clip(np.floor(in_grid + np.float32(0.5)).astype(np.intp), 0, GRID_SIZE)
    corners = [lengths_m[tuple((cells + corner).T)] for corner in np.ndindex(2, 2, 2)]
    result: Float32[np.ndarray, " n"] = np.max(corners, axis=0)
    return result


def _colours(lengths_m: Float32[np.ndarray, " n"], largest_m: float) -> UInt8[np.ndarray, "n 4"]:
    """Viridis, in linear light as glTF wants it."""
    shares = lengths_m / np.float32(largest_m) if largest_m > 0.0 else np.zeros_like(lengths_m)
    levels = np.rint(np.clip(shares, 0.0, 1.0) * 255).astype(np.uint8)
    table = cv2.applyColorMap(np.arange(256, dtype=np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0, ::-1] / 255.0
    linear = np.where(table <= 0.04045, table / 12.92, ((table + 0.055) / 1.055) ** 2.4)
    opaque = np.concatenate([np.rint(linear * 255), np.full((256, 1), 255.0)], axis=1).astype(np.uint8)
    result: UInt8[np.ndarray, "n 4"] = opaque[levels]
    return result


class _File:
    """A glTF document and its one buffer, as they grow."""

    def __init__(self) -> None:
        self._chunks: list[bytes] = []
        self._length = 0
        self._views: list[dict[str, Any]] = []
        self._accessors: list[dict[str, Any]] = []
        self._meshes: list[dict[str, Any]] = []
        self._nodes: list[dict[str, Any]] = []

    def add(
        self, name: str, vertices: Points, faces: np.ndarray, colours: np.ndarray | None, material: int,
        extras: dict[str, Any],
    ) -> None:  # fmt: skip
        """A node and its mesh; without a mesh where there is no surface, which glTF cannot say otherwise."""
        node: dict[str, Any] = {"name": name, "extras": extras}
        self._nodes.append(node)
        if len(faces) == 0:
            return
        attributes = {
            "POSITION": self._accessor(
                vertices, _FLOAT, "VEC3", min=vertices.min(axis=0).tolist(), max=vertices.max(axis=0).tolist()
            ),
            "NORMAL": self._accessor(vertex_normals(vertices, faces), _FLOAT, "VEC3"),
        }
        if colours is not None:
            attributes["COLOR_0"] = self._accessor(colours, _UINT8, "VEC4", normalized=True)
        indices = self._accessor(faces.astype(np.uint32).reshape(-1, 1), _UINT32, "SCALAR", target=_INDICES)
        node["mesh"] = len(self._meshes)
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
