"""Where a push meets the body."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float64

from service.core.arrays import GRID_SIZE, Bytes, Occupancy, Vector3
from service.core.compiled import compiled
from service.core.errors import ContactOffBody
from service.core.grids import Grid, filled_voxels

SNAP_VOXELS = 1.5
"""A contact this near to a surface voxel's centre lies on it (√3/2 voxels) or as near as a sensor can tell."""

OFF_BODY = 0.15
"""Contacts farther than this from the surface, in edges of the grid, belong to something else."""


def snap_contact(
    contact_m: Vector3, surface_m: Float64[np.ndarray, "axis=3 n"], grid: Grid, field: str
) -> tuple[Vector3, bool]:
    """The contact, moved to the nearest surface voxel where it is off the surface.

    Args:
        contact_m: Contact in the camera frame, metres.
        surface_m: The body's surface, see `surface_centres`; at least one voxel.
        grid: Where its voxels are.
        field: Path of the contact in the request, for the error.

    Returns:
        The contact in the camera frame, and whether it had to be moved.

    Raises:
        ContactOffBody: It is farther than 0.15 edges of the grid from the surface.
    """
    grid_from_camera = grid.grid_from_camera
    local = grid_from_camera[:3, :3] @ contact_m + grid_from_camera[:3, 3]
    squared = np.square(surface_m - local[:, None]).sum(axis=0)
    nearest = int(np.argmin(squared))
    distance_m = math.sqrt(squared[nearest])
    if distance_m > OFF_BODY * grid.edge_m:
        raise ContactOffBody(
            f"The contact is {distance_m * 1e3:.0f} mm away from the body.",
            field=field, expected=round(OFF_BODY * grid.edge_m, 4), actual=round(distance_m, 4),
        )  # fmt: skip
    if distance_m <= SNAP_VOXELS * grid.pitch_m:
        return contact_m, False
    snapped_m: Vector3 = grid.camera_from_grid[:3, :3] @ surface_m[:, nearest] + grid.camera_from_grid[:3, 3]
    return snapped_m, True


def surface_centres(occupancy: Occupancy, grid: Grid) -> Float64[np.ndarray, "axis=3 n"]:
    """Centres of the surface voxels in the grid's own frame, metres: found once for all contacts with a body."""
    return (filled_voxels(surface_voxels(occupancy)) + 0.5) * grid.pitch_m


def surface_voxels(occupancy: Occupancy) -> Occupancy:
    """Filled voxels with an empty one among their six neighbours; what leaves the grid counts as empty."""
    surface = np.ascontiguousarray(occupancy).copy()
    _hollow(np.ascontiguousarray(occupancy).view(np.uint8), surface.view(np.uint8))
    return surface


@compiled
def _hollow(occupancy: Bytes, surface: Bytes) -> None:
    """Take out of the surface what has six filled neighbours."""
    for x in range(1, GRID_SIZE - 1):
        for y in range(1, GRID_SIZE - 1):
            for z in range(1, GRID_SIZE - 1):
                inner = occupancy[x - 1, y, z] & occupancy[x + 1, y, z] & occupancy[x, y - 1, z]
                inner &= occupancy[x, y + 1, z] & occupancy[x, y, z - 1] & occupancy[x, y, z + 1]
                surface[x, y, z] &= 1 ^ inner
