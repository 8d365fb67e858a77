"""The families of bodies that data sets draw from, by name."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Bool
from scipy import ndimage

from training.simulation.shapes import Shape, figures, solids, structures, tight_bounds, vessels, voxelize

Sampler = Callable[[np.random.Generator, bool], Shape]

_SAMPLERS: dict[str, Sampler] = {
    "box": solids.box,
    "rounded_box": solids.rounded_box,
    "cylinder": solids.cylinder,
    "cone": solids.cone,
    "prism": solids.prism,
    "torus": solids.torus,
    "ring": solids.ring,
    "capsule": solids.capsule,
    "superquadric": solids.superquadric,
    "blob": solids.blob,
    "csg": solids.csg,
    "fruit": solids.fruit,
    "crescent": solids.crescent,
    "dumbbell": solids.dumbbell,
    "bridge": structures.bridge,
    "arch": structures.arch,
    "table": structures.table,
    "chair": structures.chair,
    "L": structures.letter_l,
    "T": structures.letter_t,
    "U": structures.letter_u,
    "h_beam": structures.h_beam,
    "stairs": structures.stairs,
    "tower": structures.tower,
    "carton": structures.carton,
    "mug": vessels.mug,
    "cup": vessels.cup,
    "bowl": vessels.bowl,
    "can": vessels.can,
    "bottle": vessels.bottle,
    "vase": vessels.vase,
    "tube": vessels.tube,
    "jug": vessels.jug,
    "mushroom": vessels.mushroom,
    "plush": figures.plush,
    "animal": figures.animal,
    "duck": figures.duck,
}

_VESSELS: dict[str, Callable[[np.random.Generator, bool, int], Shape]] = {
    "mug": vessels.mug,
    "cup": vessels.cup,
    "bowl": vessels.bowl,
}

FAMILIES: tuple[str, ...] = tuple(_SAMPLERS)

OPEN_VESSELS: tuple[str, ...] = tuple(_VESSELS)
"""Families whose walls are as thin as the simulation allows."""

CHECK_RESOLUTION = 40
SMALLEST_FOOT = 0.02
"""Least part of the body's horizontal box that touches the ground: less gives no clamp worth the name."""
MAX_TRIES = 50


def sample_shape(family: str, rng: np.random.Generator, thin: bool = False, cells: int = 24) -> Shape:
    """Draw a body that stands: in one piece, with a foot on the ground and its centre of mass above it.

    Args:
        family: One of `FAMILIES`.
        rng: Source of randomness; the same state gives the same body.
        thin: Walls and members as thin as in real objects, for cameras only. Otherwise members are meant to be at
            least three cells of 1/24 of the body grid thick; `min_thickness` tells whether this one is.
        cells: Cells along the body grid that a solid vessel of `OPEN_VESSELS` is for: its wall is three to four thick.

    Returns:
        A body about 1 wide, centred on the z axis, standing on z = 0. Scale and yaw are the caller's.

    Raises:
        KeyError: For an unknown family.
        RuntimeError: If no body of the family stood in 50 tries.
    """
    if family not in _SAMPLERS:
        raise KeyError(f"no family {family!r}; known: {', '.join(FAMILIES)}")
    for _ in range(MAX_TRIES):
        shape = _VESSELS[family](rng, thin, cells) if family in _VESSELS else _SAMPLERS[family](rng, thin)
        if stands(shape):
            return shape
    raise RuntimeError(f"no {family} stood in {MAX_TRIES} tries")


def stands(shape: Shape) -> bool:
    """Whether a body is one piece, touches z = 0 with a foot, and has its centre of mass above the foot's box."""
    box = tight_bounds(shape)
    if abs(box[2, 0]) > 0.01 * (box[2, 1] - box[2, 0]):
        return False
    occupancy, _, _ = voxelize(shape, CHECK_RESOLUTION, box)
    # Thin walls may fall between the samples, so a piece is what is connected across corners too, and crumbs are
    # forgiven.
    labels, count = ndimage.label(occupancy, np.ones((3, 3, 3), int))
    if count > 1 and np.bincount(labels.ravel())[1:].max() < 0.995 * occupancy.sum():
        return False
    foot = occupancy[:, :, 0]
    return bool(foot.sum() >= SMALLEST_FOOT * foot.size and is_balanced(occupancy, foot))


def is_balanced(occupancy: Bool[np.ndarray, "x y z"], foot: Bool[np.ndarray, "x y"]) -> bool:
    """Whether the middle of what is filled lies above the box around the foot."""
    centre = np.argwhere(occupancy)[:, :2].mean(axis=0)
    touching = np.argwhere(foot)
    return bool((touching.min(axis=0) <= centre).all() and (centre <= touching.max(axis=0)).all())
