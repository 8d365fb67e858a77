"""Versions of what training and serving must agree on; a manifest that names others is refused."""

from __future__ import annotations

GRID_CONTRACT = "1"
"""Voxel states, view grid and body grid (`service.core.voxels`, `service.core.alignment`)."""

CONDITION_CONTRACT = "1"
"""Layout of the condition vector (`service.core.condition`)."""
