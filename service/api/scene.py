"""An answer as one binary glTF 2.0 scene, which viewers and modelling programs open."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float32

from service.core.arrays import GRID_SIZE, Points
from service.core.colours import colours_of
from service.core.gltf import GltfFile
from service.core.grids import Grid, invert_rigid, transform_points
from service.core.messages import DeformResult, LoadResult
from service.core.surface_mesh import surface_mesh


def scene_glb(result: DeformResult) -> bytes:
    """The surfaces before and after each load.

    Metres in the camera's optical frame, whose y points down: nodes carry no transform. Node `reconstruction` is
    translucent; node `load <i>` is coloured by the length of the displacement, from none (dark) to the largest of all
    loads (yellow). `extras` of a node hold its numbers, those of the scene the pose of the grid.
    """
    grid = result.grid
    file = GltfFile()
    surface = surface_mesh(result.reconstruction, grid.camera_from_grid, grid.pitch_m)
    file.add("reconstruction", *surface, extras={"flags": sorted(result.flags)})
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
        file.add(f"load {number}", vertices, faces, colours_of(lengths_m, largest_m), extras)
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
    lengths_m = np.zeros((GRID_SIZE + 2,) * 3, np.float32)
    lengths_m[1:-1, 1:-1, 1:-1][load.deformed] = np.sqrt((load.moved_m**2).sum(axis=0))
    in_grid = transform_points(invert_rigid(grid.camera_from_grid), vertices) / np.float32(grid.pitch_m)
    cells = np.clip(np.floor(in_grid + np.float32(0.5)).astype(np.intp), 0, GRID_SIZE)
    corners = [lengths_m[tuple((cells + corner).T)] for corner in np.ndindex(2, 2, 2)]
    result: Float32[np.ndarray, " n"] = np.max(corners, axis=0)
    return result
