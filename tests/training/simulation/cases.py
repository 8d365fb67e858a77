"""Load cases that several tests share."""

from __future__ import annotations

import numpy as np
import trimesh

from training.simulation.case import Case, Material
from training.simulation.placement import Box

LENGTH_M, WIDTH_M = 0.08, 0.02
RUBBER = Material(young_modulus_pa=1e6, poisson_ratio=0.3, density_kg_m3=1000.0)
OFFSET_M = np.array([0.31, -0.27, 1.04])
"""Where the low corner of the bar lies: nowhere near the origin."""


def bar_triangles(axis: int = 0) -> np.ndarray:
    """A bar of 80 × 20 × 20 mm along one axis."""
    extents = np.full(3, WIDTH_M)
    extents[axis] = LENGTH_M
    mesh = trimesh.creation.box(extents)
    return np.asarray(mesh.triangles, np.float64) + extents / 2 + OFFSET_M


def below(axis: int, value: float) -> Box:
    """Everything up to a plane."""
    high = np.full(3, np.inf)
    high[axis] = value
    return Box(np.full(3, -np.inf), high)


def bar_case(axis: int = 0, **changes) -> Case:
    """The bar held at its low end; 12 cells along 72 % of the cube, so that it is 12 × 3 × 3 cells."""
    chosen = {
        "triangles_m": bar_triangles(axis),
        "material": RUBBER,
        "clamps": (below(axis, OFFSET_M[axis]),),
        "cells": 16,
        "fill": 0.75,
        **changes,
    }
    return Case(**chosen)
