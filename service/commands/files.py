"""An answer as a file of the kind that its suffix says."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from service.client.result import Result
    from service.core.messages import DeformResult

SUFFIXES = (".npz", ".ply", ".glb", ".bt", ".binvox")


def write(result: Result, path: Path) -> Path:
    """Write a result: `.glb` both surfaces, coloured by displacement; `.npz` everything; the others the deformed body.

    Raises:
        OSError: The file cannot be written.
    """
    if path.suffix == ".glb":
        from service.api.scene import scene_glb

        path.write_bytes(scene_glb(_as_answered(result)))
        return path
    return result.save(path)


def _as_answered(result: Result) -> DeformResult:
    """What a predictor said, from what a client made of it; every output was asked for."""
    from service.core.messages import DeformResult, LoadResult

    assert result.body_probability is not None
    loads = []
    for push in result.pushes:
        assert push.probability is not None and push.displacement_m is not None
        loads.append(
            LoadResult(
                push.deformed, push.probability, push.displacement_m.astype(np.float32), push.max_displacement_m,
                push.mean_displacement_m, push.load_number, push.flags,
            )
        )  # fmt: skip
    return DeformResult(
        grid=result.grid,
        observed=result.seen,
        reconstruction=result.reconstruction,
        reconstruction_probability=result.body_probability,
        loads=tuple(loads),
        flags=result.flags,
        model_name=result.model[0],
        model_version=result.model[1],
        timing_ms=result.timing_ms,
    )
