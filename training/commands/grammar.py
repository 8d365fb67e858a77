"""What the options of `physnet-train solve` look like, in the unit of the mesh file."""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass

import numpy as np

from service.core.arrays import Vector3

UNITS_M = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "ft": 0.3048}
_AXES = {"x": 0, "y": 1, "z": 2}


@dataclass(frozen=True, eq=False)
class LoadOption:
    """`--load`: contact and radius in the unit of the file."""

    contact: Vector3
    force_n: Vector3
    radius: float | None


@dataclass(frozen=True, eq=False)
class BoxOption:
    """`--clamp` other than ground: a box in the unit of the file, with infinite sides where it is a half space."""

    low: Vector3
    high: Vector3


def vector(text: str) -> Vector3:
    """Three numbers, `x,y,z`.

    Raises:
        argparse.ArgumentTypeError: they are not.
    """
    parts = [_number(part) for part in text.split(",")]
    if len(parts) != 3:
        raise argparse.ArgumentTypeError(f"{text!r} holds {len(parts)} numbers; three are wanted: x,y,z")
    return np.array(parts, np.float64)


def load(text: str) -> LoadOption:
    """`x,y,z:fx,fy,fz` or `x,y,z:fx,fy,fz:radius`: contact and radius in the file's unit, force in newtons.

    Raises:
        argparse.ArgumentTypeError: it is neither.
    """
    parts = text.split(":")
    if len(parts) not in (2, 3):
        raise argparse.ArgumentTypeError(f"{text!r} is no load; write x,y,z:fx,fy,fz or x,y,z:fx,fy,fz:radius")
    radius = _number(parts[2]) if len(parts) == 3 else None
    if radius is not None and radius <= 0:
        raise argparse.ArgumentTypeError(f"the patch of load {text!r} has a radius of {radius:g}; it must be positive")
    return LoadOption(vector(parts[0]), vector(parts[1]), radius)


def clamp(text: str) -> BoxOption | None:
    """None for `ground`; `box:x0,y0,z0,x1,y1,z1`, `below:axis=value` or `above:axis=value`, in the file's unit.

    Raises:
        argparse.ArgumentTypeError: it is none of them, or a box without extent.
    """
    kind, _, rest = text.partition(":")
    if text == "ground":
        return None
    low, high = np.full(3, -math.inf), np.full(3, math.inf)
    if kind == "box":
        numbers = [_number(part) for part in rest.split(",")]
        if len(numbers) != 6:
            wanted = "six are wanted: x0,y0,z0,x1,y1,z1"
            raise argparse.ArgumentTypeError(f"{text!r} holds {len(numbers)} numbers; {wanted}")
        low, high = np.array(numbers[:3]), np.array(numbers[3:])
        if (low > high).any():
            raise argparse.ArgumentTypeError(f"{text!r} is no box: its low corner comes first")
        return BoxOption(low, high)
    axis, equals, value = rest.partition("=")
    if kind in ("below", "above") and axis in _AXES and equals:
        (high if kind == "below" else low)[_AXES[axis]] = _number(value)
        return BoxOption(low, high)
    raise argparse.ArgumentTypeError(
        f"{text!r} is no clamp; write ground, box:x0,y0,z0,x1,y1,z1, below:z=0 or above:x=1.5"
    )


def _number(text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise argparse.ArgumentTypeError(f"{text!r} is no number")
    return number
