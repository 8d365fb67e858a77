"""Binvox files: run lengths of voxels with a scale and an offset, no rotation.

Source: Min, binvox voxel file format, https://www.patrickmin.com/binvox/binvox.html: the index runs y first, then z,
then x; pairs of bytes (value, count) follow the header. `scale` is the edge of the whole cube, `translate` its corner.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool

_LONGEST_RUN = 255


def encode_binvox(
    occupancy: Bool[np.ndarray, "x y z"], edge_m: float, corner_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> bytes:
    """A binvox file.

    Args:
        occupancy: A cube of voxels.
        edge_m: Edge of the whole cube.
        corner_m: Its lowest corner.
    """
    values = occupancy.transpose(0, 2, 1).astype(np.uint8).ravel()
    starts = np.flatnonzero(np.diff(values, prepend=2))
    lengths = np.diff(starts, append=len(values))
    # A run longer than a byte can say is several.
    pieces = -(-lengths // _LONGEST_RUN)
    counts = np.full(int(pieces.sum()), _LONGEST_RUN)
    counts[np.cumsum(pieces) - 1] = lengths - (pieces - 1) * _LONGEST_RUN
    runs = np.column_stack([np.repeat(values[starts], pieces), counts]).astype(np.uint8)
    dim = " ".join(str(number) for number in occupancy.shape)
    translate = " ".join(repr(float(number)) for number in corner_m)
    header = f"#binvox 1\ndim {dim}\ntranslate {translate}\nscale {float(edge_m)!r}\ndata\n"
    return header.encode("ascii") + runs.tobytes()
