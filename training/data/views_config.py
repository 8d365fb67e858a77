"""The configuration of the `views` set: which families are drawn, and what befalls a body and its views how often."""

from __future__ import annotations

from dataclasses import dataclass

from training.simulation.families import FAMILIES

HOLLOW = ("mug", "cup", "bowl", "vase", "tube")
"""Vessels one can look into: their insides and walls are what a view tells least about."""
COMMON = ("box", "rounded_box", "cylinder", "can", "bottle", "carton", "jug", "csg", "blob", "animal")
"""What shelves are full of, and the families that repeat themselves least."""
DRAWN = (*FAMILIES, *HOLLOW, *HOLLOW, *COMMON)
"""Families to draw from: a name that stands twice is drawn twice as often."""
TIPPABLE = ("mug", "cup", "bowl", "vase", "bottle", "can", "cylinder", "jug", "carton")
"""Families that are also met lying, or upside down."""
ROUND_FOOTED = (
    "superquadric", "blob", "csg", "fruit", "dumbbell", "capsule", "plush", "animal", "duck", "crescent", "rounded_box",
    "box", "cylinder", "carton", "can", "bottle", "jug",
)  # fmt: skip
"""Solid families whose foot may be made smaller: what stands about seldom stands on all of its width."""


@dataclass(frozen=True)
class ViewsConfig:
    """What is drawn for each body.

    Attributes:
        seed: Group i draws from SeedSequence((seed, i)).
        views: Viewpoints on each body.
        thin: Share of bodies with walls and members as thin as real ones.
        thin_hollow: The same of vessels one can look into.
        stretch: Chance that a body is stretched along its axes.
        stretched: Range of each factor, drawn log-uniformly; heights are, and half as much the two widths.
        families: Names to draw from, all alike.
        undercut: Chance that a body of `ROUND_FOOTED` is narrower towards the ground.
        undercut_share: How much on the ground, drawn uniformly.
        undercut_height: Up to where, in units of what half of its lesser width loses, drawn uniformly.
        tipped: Chance that a body of a family that is met so lies on its side, or else stands upside down.
        size_m: Range of the longest edge of the body's box, drawn log-uniformly.
        clutter: Share of views with another body in them.
        occluder: Share of those where it stands before the object and hides a part of it; else it is beside or behind.
        hidden: Range of the part of the object's pixels that an occluder hides.
        table: Share of views where the support plane ends, as tables do; endless otherwise.
        masked: Share of views where a mask comes with the frame; its edge is off by a pixel or two.
        upright: Share of views where `up` is given, off by up to a degree.
        overlap: Least IoU of the segmented pixels with the true ones: another object teaches nothing.
    """

    seed: int = 0
    views: int = 4
    thin: float = 0.4
    thin_hollow: float = 0.65
    stretch: float = 0.5
    stretched: tuple[float, float] = (0.7, 1.4)
    families: tuple[str, ...] = DRAWN
    undercut: float = 0.0
    undercut_share: tuple[float, float] = (0.05, 0.7)
    undercut_height: tuple[float, float] = (0.5, 2.0)
    tipped: float = 0.2
    size_m: tuple[float, float] = (0.05, 0.40)
    clutter: float = 0.25
    occluder: float = 0.5
    hidden: tuple[float, float] = (0.03, 0.6)
    table: float = 0.3
    masked: float = 0.5
    upright: float = 0.6
    overlap: float = 0.5
