"""Every data set by name: its configuration, its draw, and how many groups it has in full."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from training.data import everyday, meshes, paper, partial_views, views
from training.data.everyday import EverydayConfig
from training.data.meshes import MeshesConfig
from training.data.paper import PaperConfig
from training.data.partial_views import PartialViewsConfig
from training.data.samples import YOUNG_MAX_PA
from training.data.views_config import ROUND_FOOTED, ViewsConfig
from training.simulation.families import FAMILIES

CYLINDER_LIKE = ("cylinder", "can", "tube", "bottle", "vase", "cup", "capsule")
"""What `cylinders` is drawn from; `cross-category` is drawn from all other families."""

PUSH_N = 8.5e6
"""Overlaps the softest bridge with itself at rest by an IoU of 0.40, as in the softest of the released samples."""
PRESS_N = 7e6
"""Bends the end of the softest bridge's deck down by nine tenths of its height."""

_MATERIALS = (0.05 * YOUNG_MAX_PA, YOUNG_MAX_PA)
_PAPER_LOADS = EverydayConfig(
    loads=10, along_top=True, fractions=None, identity_iou=(0.5, 0.95), patch_radius=(0.1, 0.1),
    young_modulus_pa=_MATERIALS,
)  # fmt: skip
_GENTLE = EverydayConfig(loads=2, fractions=None, peak=(0.008, 0.03))
_ROUND_FOOTED = ViewsConfig(families=ROUND_FOOTED, undercut=0.75)
_UPRIGHT = ViewsConfig(families=EverydayConfig().families, thin=0.0, thin_hollow=0.0, tipped=0.0)
_STRETCH = PaperConfig(young_modulus_pa=(1e9, 1e9, 1), force_n=(2e6, 1), scales=(0.85, 1.2, 8), cells=40)

Draw = Callable[[int], dict[str, np.ndarray]]
Config = EverydayConfig | ViewsConfig | PaperConfig | PartialViewsConfig | MeshesConfig


@dataclass(frozen=True)
class DataSet:
    """A data set by name.

    Attributes:
        config: What is drawn.
        groups: Groups of the full set; for the paper's sets this is the paper's count, where it gives one.
        about: One line of help.
    """

    config: Config
    groups: int
    about: str

    def with_seed(self, seed: int) -> DataSet:
        """The same with another seed; a grid of values has none."""
        if isinstance(self.config, (EverydayConfig, ViewsConfig)):
            return dataclasses.replace(self, config=dataclasses.replace(self.config, seed=seed))
        return self

    def with_loads(self, loads: int) -> DataSet:
        """The same with another number of pushes on each body.

        Raises:
            ValueError: Its bodies are not pushed at places that are drawn.
        """
        if not isinstance(self.config, EverydayConfig):
            raise ValueError("only sets of bodies under drawn pushes have a number of loads")
        return dataclasses.replace(self, config=dataclasses.replace(self.config, loads=loads))

    @property
    def is_grid(self) -> bool:
        """Whether the set is a grid of values, which ends."""
        return isinstance(self.config, (PaperConfig, PartialViewsConfig))

    @property
    def draw(self) -> Draw:
        """From a group's index to its arrays; picklable."""
        match self.config:
            case MeshesConfig():
                return functools.partial(meshes.draw_group, self.config)
            case EverydayConfig():
                return functools.partial(everyday.draw_group, self.config)
            case ViewsConfig():
                return functools.partial(views.draw_group, self.config)
            case PaperConfig():
                return functools.partial(paper.draw_group, self.config)
            case PartialViewsConfig():
                return functools.partial(partial_views.draw_group, self.config)

    def configuration(self, name: str, groups: int) -> dict[str, Any]:
        """What the manifest says."""
        return {"set": name, "groups": groups, **dataclasses.asdict(self.config)}


MESHES = "meshes"
"""The set that is not in `SETS`: what it draws is in somebody's folder (`training.data.meshes.meshes_in`)."""

GROUPS_OF_MESHES = 400
"""An evening on two cores; twenty bodies of each of twenty meshes."""

SETS: dict[str, DataSet] = {
    "everyday": DataSet(EverydayConfig(), 2000, "bodies of all families under random pushes, neo-Hookean; the default"),
    "gentle": DataSet(_GENTLE, 4000, "bodies of `everyday`, two gentle linear pushes each: many bodies in little time"),
    "views": DataSet(ViewsConfig(), 4000, "bodies of all families seen by a noisy depth camera"),
    "round-footed": DataSet(_ROUND_FOOTED, 1500, "views of solid bodies that stand on a part of their width"),
    "upright": DataSet(_UPRIGHT, 1500, "views of bodies as `everyday` pushes them"),
    "bridge-1x400": DataSet(
        PaperConfig(young_modulus_pa=(*_MATERIALS, 400), force_n=(PUSH_N, 1)), 400, "the paper's: 400 E, one ν"
    ),
    "bridge-20x20": DataSet(
        PaperConfig(young_modulus_pa=(*_MATERIALS, 20), poisson_ratio=(0.0, 0.49, 20), force_n=(PUSH_N, 1)),
        400, "the paper's: 20 E × 20 ν",
    ),
    "bridge-force": DataSet(
        PaperConfig(force_n=(PRESS_N, 31), locations=10), 310, "the paper's: 31 forces × 10 places along the top"
    ),
    "stretch": DataSet(_STRETCH, 512, "the paper's: 8 scales along each axis"),
    "cylinders": DataSet(
        dataclasses.replace(_PAPER_LOADS, families=CYLINDER_LIKE), 400, "the paper's: cylinder-like, 10 pushes a body"
    ),
    "cross-category": DataSet(
        dataclasses.replace(_PAPER_LOADS, families=tuple(name for name in FAMILIES if name not in CYLINDER_LIKE)),
        100, "the paper's: bodies unlike cylinders, to test on",
    ),
    "partial-views": DataSet(
        PartialViewsConfig(_STRETCH), 400, "the paper's: stretched bridges from 125 rotations, 50,000 views"
    ),
}  # fmt: skip
