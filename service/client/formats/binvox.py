"""Binvox files: run lengths of voxels with a scale and an offset, no rotation. trimesh writes them.

Source: Min, binvox voxel file format, https://www.patrickmin.com/binvox/binvox.html: the index runs y first, then z,
then x. `scale` is the edge of the whole cube, `translate` its corner.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool


def encode_binvox(
    occupancy: Bool[np.ndarray, "x y z"], edge_m: float, corner_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> bytes:
    """A binvox file.

    Args:
        occupancy: A cube of voxels.
        edge_m: Edge of the whole cube.
        corner_m: Its lowest corner.
    """
    # Imported where it is used: 0.1 s, and 1 s where SciPy is there, which only those wait who want such a file.
    from trimesh.exchange.binvox import binvox_bytes
    from trimesh.voxel.runlength import dense_to_rle

    values = occupancy.transpose(0, 2, 1).astype(np.uint8).ravel()
    runs = dense_to_rle(values, np.uint8).reshape(-1, 2)
    # A run of a multiple of 255 ends with one of no voxels, which the format does not know.
    runs = runs[runs[:, 1] > 0]
    # Not trimesh's `export_binvox`: it puts the centres of the first and last voxels onto the corners of the cube.
    return bytes(binvox_bytes(runs, occupancy.shape, corner_m, edge_m))
