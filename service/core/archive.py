"""Arrays as one NumPy archive."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Mapping

import numpy as np


def npz_bytes(arrays: Mapping[str, np.ndarray]) -> bytes:
    """An archive that `np.load` reads, its grids at the fastest compression.

    Occupancy shrinks 50-fold at it, and zlib's default, the only one of `np.savez_compressed`, costs five times as
    much. Lists of numbers and of vectors shrink by a tenth and stay as they are.
    """
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as archive:
        for name, array in arrays.items():
            file = io.BytesIO()
            np.lib.format.write_array(file, array, allow_pickle=False)
            packed = zipfile.ZIP_DEFLATED if array.ndim > 2 else zipfile.ZIP_STORED
            archive.writestr(f"{name}.npy", file.getbuffer(), packed, compresslevel=1)
    return buffer.getvalue()
