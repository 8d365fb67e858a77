"""Where a push meets the body."""

from __future__ import annotations

import numpy as np

from service.core.arrays import Occupancy, Vector3
from service.core.errors import ContactOffBody
from service.core.grids import Grid, invert_rigid

SNAP_VOXELS = 1.5
"""A contact this near to a surface voxel's centre lies on it (√3/2 voxels) or as near as a sensor can tell."""

OFF_BODY = 0.15
"""Contacts farther than this from the surface, in edges of the grid, belong to something else."""


def snap_contact(contact_m: Vector3, occupancy: Occupancy, grid: Grid, field: str) -> tuple[Vector3, bool]:
    """The contact, moved to the nearest surface voxel where it is off the surface.

    Args:
        contact_m: Contact in the camera frame, metres.
        occupancy: The body; at least one voxel.
        grid: Where its voxels are.
        field: Path of the contact in the request, for the error.

    Returns:
        The contact in the camera frame, and whether it had to be moved.

    Raises:
        ContactOffBody: It is farther than 0.15 edges of the grid from the surface.
    """
    grid_from_camera = invert_rigid(grid.camera_from_grid)
    local = grid_from_camera[:3, :3] @ contact_m + grid_from_camera[:3, 3]
    centres = (np.argwhere(surface_voxels(occupancy)) + 0.5) * grid.pitch_m
    distances = np.linalg.norm(centres - local, axis=1)
    nearest = int(np.argmin(distances))
    distance_m = float(distances[nearest])
    if distance_m > OFF_BODY * grid.edge_m:
        raise ContactOffBody(
            f"The contact is {distance_m * 1e3:.0f} mm away from the body.",
            field=field, expected=round(OFF_BODY * grid.edge_m, 4), actual=round(distance_m, 4),
        )  # fmt: skip
    if distance_m <= SNAP_VOXELS * grid.pitch_m:
        return contact_m, False
    snapped_m: Vector3 = grid.camera_from_grid[:3, :3] @ centres[nearest] + grid.camera_from_grid[:3, 3]
    return snapped_m, True


def surface_voxels(occupancy: Occupancy) -> Occupancy:
    """Filled voxels with an empty one among their six neighbours; what leaves the grid counts as empty."""
    padded = np.pad(occupancy, 1)
    inner = occupancy.copy()
    for axis in range(3):
        for start in (0, 2):
            window = [slice(1, -1)] * 3
            window[axis] = slice(start, start + occupancy.shape[axis])
            inner &= padded[tuple(window)]
    surface: Occupancy = occupancy & ~inner
    return surface
