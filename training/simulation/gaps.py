"""Gaps too narrow for the cells: two sides of a slit that share a node move as one, whatever lies between them."""

from __future__ import annotations

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy import ndimage

from training.simulation.body import Body
from training.simulation.elements import CORNERS

MAX_NARROW_GAPS = 0.02
"""Share beyond which a body moves otherwise than on finer cells: it is solved there, or not at all."""
SOLID = 0.75
"""An octant with at least this much material counts as filled: a slit of half an octant, a quarter of a cell, shows."""
CRUMB = 2
"""A piece of fewer octants than this is the staircase of a slanted face, not a second body."""
_EDGE = 6
"""Octants along an edge of what a cell and its 26 neighbours cover."""


def narrow_gaps(body: Body) -> float:
    """Share of the cells cut by the surface in which unconnected pieces of material meet, in [0, 1].

    The material of a cut cell and its 26 neighbours should be one piece. Where it is two, the nodes of the cell hold
    together what is apart: a slit narrower than a cell always does so, one of up to two cells where it lies badly. A
    few cells in the crotch of two limbs do so in sound bodies too, hence a share.
    """
    octants = np.zeros((2 * body.cells + 4,) * 3, bool)
    place = 2 * body.active[None] + CORNERS[:, None] + 2
    octants[tuple(np.moveaxis(place, -1, 0))] = body.octant_fill >= SOLID
    cut = body.active[body.octant_fill.min(axis=0) < 1.0]
    if len(cut) == 0:
        return 0.0
    windows = sliding_window_view(octants, (_EDGE,) * 3)[tuple(2 * cut.T)]
    within = np.zeros((3,) * 4, int)
    within[1] = ndimage.generate_binary_structure(3, 1)
    labels, pieces = ndimage.label(windows, within)
    window_of = np.zeros(pieces + 1, int)
    window_of[labels.reshape(len(cut), -1)] = np.arange(len(cut))[:, None]
    sizes = np.bincount(labels.ravel(), minlength=pieces + 1)[1:]
    largest = np.zeros(len(cut), int)
    np.maximum.at(largest, window_of[1:], sizes)
    apart = np.bincount(window_of[1:], weights=sizes, minlength=len(cut)) - largest
    return float((apart >= CRUMB).mean())
