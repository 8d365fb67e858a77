"""Binary glTF: the surfaces before and after each push, as the service's own scene names them."""

from __future__ import annotations

import numpy as np

from service.client.result import Result
from service.core.colours import colours_of
from service.core.gltf import GltfFile


def encode_glb(result: Result) -> bytes:
    """A scene in the camera's optical frame, metres; its nodes carry no transform.

    Node `reconstruction` is translucent; node `load <i>` is coloured by displacement, from none (dark) to the largest
    of all pushes (yellow), where the reply has the field. `extras` of a node hold its numbers.
    """
    file = GltfFile()
    if result.body is not None:
        mesh = result.mesh("reconstruction")
        file.add("reconstruction", mesh.vertices_m, mesh.faces, extras={"flags": sorted(result.flags)})
    largest_m = max((push.max_displacement_m for push in result), default=0.0)
    for number, push in enumerate(result):
        mesh = push.mesh()
        moved_m = np.zeros(len(mesh.vertices_m), np.float32)
        if push.displacement is not None:
            moved_m = np.linalg.norm(push.displacement_at(mesh.vertices_m, "deformed"), axis=1)
        extras = {
            "max_displacement_m": push.max_displacement_m,
            "mean_displacement_m": push.mean_displacement_m,
            "load_number": push.load_number,
            "flags": sorted(push.flags),
        }
        file.add(f"load {number}", mesh.vertices_m, mesh.faces, colours_of(moved_m, largest_m), extras)
    name, version = result.model
    return file.encode(
        {
            "frame": "camera optical frame: x right, y down, z forward; metres",
            "model": {"name": name, "version": version},
            "voxel_size_m": result.grid.pitch_m,
            "camera_from_grid": result.grid.camera_from_grid.tolist(),
            "largest_displacement_m": largest_m,
        }
    )
