"""Answers made by hand: a body whose displacement is known everywhere."""

from __future__ import annotations

import numpy as np

from service.client import PushResult, Result
from service.client.displacement import DisplacementField
from service.core.grids import Grid
from tests.poses import pose

PITCH_M = 0.004
GRID = Grid(PITCH_M, pose((0.4, -0.2, 0.9), (0.05, 0.02, 0.7)))
SLOPE = 0.2
"""Of the shear: x moves by this share of the height."""

_CENTRES = (np.indices((64, 64, 64)) + 0.5) * PITCH_M
# A lying egg, unlike itself under every rotation and mirror image of the axes.
BODY = ((_CENTRES[0] - 0.10) / 0.05) ** 2 + ((_CENTRES[1] - 0.13) / 0.07) ** 2 + ((_CENTRES[2] - 0.05) / 0.045) ** 2 < 1
BODY &= _CENTRES[1] + _CENTRES[0] < 0.26


def sheared(points_grid_m: np.ndarray) -> np.ndarray:
    """How far the material at places of the rest body goes, grid axes: u = (0.2 z, 0, 0)."""
    moved = np.zeros_like(points_grid_m)
    moved[:, 0] = SLOPE * points_grid_m[:, 2]
    return moved


def answer(loads: int = 1) -> Result:
    """The egg, sheared along x by its height; as it would have come over a wire with every output."""
    x, y, z = _CENTRES
    rest = ((x - SLOPE * z - 0.10) / 0.05) ** 2 + ((y - 0.13) / 0.07) ** 2 + ((z - 0.05) / 0.045) ** 2 < 1
    deformed = rest & (y + x - SLOPE * z < 0.26)
    field_m = np.zeros((3, 64, 64, 64), np.float16)
    # A shear along x leaves z as it is, so the field on the deformed body is the same function of z.
    field_m[0][deformed] = SLOPE * z[deformed]
    push = PushResult(
        grid=GRID, occupancy=deformed, probability=deformed.astype(np.float32),
        displacement=DisplacementField(field_m, deformed),
        max_displacement_m=float(field_m[0].max()), mean_displacement_m=float(field_m[0][deformed].mean()),
        load_number=0.01, flags=frozenset({"contact_snapped"}),
    )  # fmt: skip
    return Result(
        request_id="by-hand", model=("hand", "1"), grid=GRID, seen=BODY & (y < 0.1), body=BODY,
        body_probability=BODY.astype(np.float32), pushes=(push,) * loads, flags=frozenset(), timing_ms={"total": 1.0},
    )  # fmt: skip


def in_camera(points_grid_m: np.ndarray) -> np.ndarray:
    """Points of the grid's frame in the camera's."""
    return points_grid_m @ GRID.camera_from_grid[:3, :3].T + GRID.camera_from_grid[:3, 3]
