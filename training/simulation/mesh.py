"""Watertight meshes as bodies: any file that trimesh reads, checked, merged and turned the right way out."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Literal

import numpy as np
import trimesh
from jaxtyping import Float64, Int64

from training.simulation.distance_grid import RESOLUTION, Triangles, distance_grid
from training.simulation.shapes import Shape, stand

PLAUSIBLE_M = (0.003, 3.0)
"""Sizes outside of which a mesh was probably written in another unit."""
MERGE_TOLERANCE = 1e-7
"""Vertices nearer than this part of the mesh's size are one: STL and glTF repeat them on every face."""


class MeshError(ValueError):
    """A mesh file that gives no body.

    MeshError
    ├── EmptyMesh       no triangles, or none with an area
    └── NotWatertight   edges that don't join exactly two faces
    """


class EmptyMesh(MeshError):
    """The file holds no triangles."""


class NotWatertight(MeshError):
    """`open_edges` counts the edges that don't join exactly two faces."""

    def __init__(self, message: str, *, open_edges: int) -> None:
        super().__init__(message)
        self.open_edges = open_edges


def mesh_shape(
    path: str | Path, unit_m: float = 1.0, up_axis: Literal["x", "y", "z"] = "z", resolution: int = RESOLUTION
) -> Shape:
    """A body from a mesh file, standing on z = 0 and centred on the z axis, in metres.

    Inside-out meshes are turned with a warning; repeated vertices are merged.

    Args:
        path: OBJ, STL, PLY, glTF or what else trimesh reads; a scene's parts are joined.
        unit_m: Length of the file's unit in metres: 0.001 for millimetres.
        up_axis: Axis of the file that points away from the ground; glTF files use y.
        resolution: Cells of the distance grid along the longest edge.

    Raises:
        FileNotFoundError: If there is no such file.
        EmptyMesh: If it holds no triangles.
        NotWatertight: If it has open edges, so that inside and outside are not told apart.
        MeshError: If it cannot be read at all.
    """
    path = Path(path)
    triangles = load_triangles(path, unit_m)
    triangles = triangles[..., {"x": [1, 2, 0], "y": [2, 0, 1], "z": [0, 1, 2]}[up_axis]]  # even permutations
    body = distance_grid(triangles, resolution)
    return stand(path.stem, body, box=body.bounds)


def load_triangles(path: Path, unit_m: float) -> Triangles:
    """Corners of a checked mesh's outward faces, in metres and the file's own axes.

    Warns of a size that speaks for another unit, and of a mesh that had to be turned inside out.

    Args:
        path: OBJ, STL, PLY, glTF or what else trimesh reads.
        unit_m: Length of the file's unit in metres: 0.001 for millimetres.

    Raises:
        FileNotFoundError: If there is no such file.
        MeshError: Any of its leaves, as `load_mesh`.
    """
    triangles = np.asarray(load_mesh(path).triangles, np.float64) * unit_m
    size_m = float(np.ptp(triangles.reshape(-1, 3), axis=0).max())
    if not PLAUSIBLE_M[0] <= size_m <= PLAUSIBLE_M[1]:
        warnings.warn(
            f"{path.name} is {size_m:.3g} m long: is its unit {unit_m:g} m? (0.001 for millimetres)", stacklevel=2
        )
    return triangles


def load_mesh(path: Path) -> trimesh.Trimesh:
    """Read, merge and check a mesh; one that is inside out is turned, with a warning.

    Raises:
        FileNotFoundError: If there is no such file.
        EmptyMesh: If it holds no triangles.
        NotWatertight: If it has open edges.
        MeshError: If it cannot be read at all.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no mesh file at {path}")
    try:
        mesh = trimesh.load(path, force="mesh", process=False)
    except Exception as error:  # each of trimesh's readers raises what it likes
        raise MeshError(f"{path.name} cannot be read as a mesh: {error}") from error
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise EmptyMesh(f"{path.name} holds no triangles")
    faces, vertices = _merged(np.asarray(mesh.vertices, np.float64), np.asarray(mesh.faces, np.int64))
    if len(faces) == 0:
        raise EmptyMesh(f"{path.name} holds no triangle with an area")
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    _, uses = np.unique(mesh.edges_sorted, axis=0, return_counts=True)
    # An even number is a closed surface too: bodies that touch along an edge share it four times.
    open_edges = int((uses % 2 != 0).sum())
    if open_edges:
        raise NotWatertight(
            f"{path.name} is not watertight: {open_edges} of {len(uses)} edges are open; close the holes first",
            open_edges=open_edges,
        )
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)
    if mesh.volume < 0:
        warnings.warn(f"{path.name} is inside out: its faces were turned", stacklevel=2)
        mesh.invert()
    return mesh


def _merged(
    vertices: Float64[np.ndarray, "n 3"], faces: Int64[np.ndarray, "m 3"]
) -> tuple[Int64[np.ndarray, "k 3"], Float64[np.ndarray, "l 3"]]:
    """Faces over vertices merged by position, less those that collapse."""
    vertices_used = vertices[faces.ravel()]
    size = float(np.ptp(vertices_used, axis=0).max()) if len(vertices_used) else 0.0
    if not np.isfinite(size) or size == 0.0:
        return np.zeros((0, 3), np.int64), vertices
    keys = np.round(vertices / (MERGE_TOLERANCE * size)).astype(np.int64)
    _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    merged = index.reshape(-1)[faces].astype(np.int64)
    a, b, c = merged.T
    return merged[(a != b) & (b != c) & (c != a)], vertices[first]
