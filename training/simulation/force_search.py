"""Choosing a force that deforms a body by a wanted amount."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from training.simulation.body import Body
from training.simulation.loads import Load
from training.simulation.overlap import RestOverlap

_STEPS = 14
_FEW = 4
"""One point in so many is looked at first."""
_TOLERANCE = 0.01
_POWERS = (0.3, 2.0)
"""Range of the power of the force that two looks may tell."""
_MAX_STRETCH = 0.6
"""Largest displacement in units of L that the search will try; beyond it a body has left the cube."""


def force_for_identity_iou(
    overlap: RestOverlap, load: Load, displacement: Float64[np.ndarray, "nodes 3"], target: float
) -> Load | None:
    """The load whose linear response overlaps the undeformed body to a wanted IoU.

    The linear response scales with the force, so each trial costs one look at the points of `overlap`: at some of them
    until those agree, then at all.

    Args:
        overlap: Of the body.
        load: Any load number above zero.
        displacement: Linear nodal displacements under `load`.
        target: Wanted IoU in (0, 1).

    Returns:
        The same load with another load number; None where no displacement within the cube overlaps that little.
    """
    peak = _peak(overlap.body, displacement)
    if not 0.0 < peak < np.inf:
        return None
    along = overlap.along(displacement)
    limit = _MAX_STRETCH / peak
    low, high = 0.0, np.inf
    # 1/IoU − 1 grows with a power of the force close to one, which two looks tell: bisect when that leaves the bracket
    wanted = math.log(1.0 / target - 1.0)
    power, before, every = 1.0, None, _FEW
    factor = 0.1 / peak
    for _ in range(_STEPS):
        seen = along.iou(factor, every)
        found = abs(seen - target) < _TOLERANCE
        if every > 1 and (found or (seen > target and factor == limit) or high - low < 0.03 * high):
            every, low, high, before = 1, 0.0, np.inf, None
            continue
        if found:
            break
        if seen > target:
            if factor == limit:
                return None
            low = factor
        else:
            high = factor
        if high - low < 1e-3 * high:
            break
        now = (math.log(factor), math.log(max(1.0 / max(seen, 1e-3) - 1.0, 1e-3)))
        if before is not None and now[0] != before[0]:
            power = min(max((now[1] - before[1]) / (now[0] - before[0]), _POWERS[0]), _POWERS[1])
        before = now
        factor *= math.exp((wanted - now[1]) / power)
        # where the target seems out of reach, one look at the limit decides
        factor = min(factor, limit)
        if not low < factor < high:
            factor = 0.5 * (low + high)
    return replace(load, load_number=load.load_number * factor)


def force_for_peak(
    body: Body, load: Load, displacement: Float64[np.ndarray, "nodes 3"], peak: float
) -> Load | None:
    """The load whose linear response moves the node that goes farthest by a wanted distance.

    Args:
        body: That is pushed.
        load: Any load number above zero.
        displacement: Linear nodal displacements under `load`.
        peak: Wanted, in units of L.

    Returns:
        The same load with another load number; None where nothing moves.
    """
    found = _peak(body, displacement)
    return replace(load, load_number=load.load_number * peak / found) if 0.0 < found < np.inf else None


def _peak(body: Body, displacement: Float64[np.ndarray, "nodes 3"]) -> float:
    solid = displacement[body.solid_nodes]
    return math.sqrt(float(np.einsum("ni,ni->n", solid, solid).max(initial=0.0)))
