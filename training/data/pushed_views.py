"""Pushed bodies as a noisy depth camera saw them at rest: what a single network from view to deformed shape learns of.

The bodies, loads and deformed shapes are those of an `everyday` set; the views are drawn as the `views` set draws them.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, Float64, Int, UInt8
from torch import Tensor

from service.core.alignment import resample
from service.core.arrays import GRID_SIZE, Occupancy
from service.core.condition import Condition, encode_condition
from service.core.grids import Grid, pack_bits, unpack_bits
from training.data.batches import split_of, unpack
from training.data.body_cube import place_in_body_grid
from training.data.frames import Frame, draw_frame
from training.data.generate import Dropped
from training.data.store import Store
from training.data.views_config import ViewsConfig
from training.metrics import iou
from training.simulation.distance_grid import DistanceGrid
from training.simulation.families import OPEN_VESSELS, sample_shape
from training.simulation.grid_body import filled, sampled, scaled

KEPT = ("family", "edge_m", "rest", "condition", "deformed", "identity_iou", "young_modulus_pa", "force_n", "sample")
"""What is taken over of a group of the `everyday` set."""

SAME = 0.95
"""Least IoU of a body drawn again with its voxels in the set: a family that is drawn otherwise by now is left out."""


@dataclass(frozen=True)
class PushedViewsConfig:
    """What is drawn.

    Attributes:
        bodies: Folder of the `everyday` set.
        views: How bodies are seen; with a mask, so that the service needs no contact to find the object.
    """

    bodies: str
    views: ViewsConfig = field(default_factory=lambda: ViewsConfig(views=2, masked=1.0))


def body_again(store: Store, index: int) -> DistanceGrid:
    """The exact body of a group in metres, in the frame of its body grid, drawn again from the seed of its set.

    Raises:
        Dropped: It is not the body that the set holds the voxels of.
    """
    config = store.manifest()["configuration"]
    rng = np.random.default_rng(np.random.SeedSequence((config["seed"], index)))
    family = config["families"][rng.integers(len(config["families"]))]
    cells = config["vessel_cells"] if family in OPEN_VESSELS else config["cells"]
    try:
        body = sampled(place_in_body_grid(sample_shape(family, rng, cells=cells)).shape)
    except (RuntimeError, ValueError) as error:
        raise Dropped("no_shape") from error
    group = store.group(index)
    if iou(filled(body, Grid(1.0 / GRID_SIZE, np.eye(4))), unpack_bits(group["rest"])) < SAME:
        raise Dropped("drawn_otherwise")
    return scaled(body, float(group["edge_m"]))


def frames(config: PushedViewsConfig, index: int) -> Iterator[tuple[int, Frame]]:
    """The views of a body by their number, the same whenever they are asked for; those without the object are left out.

    Raises:
        Dropped: See `body_again`.
    """
    body = body_again(Store(Path(config.bodies)), index)
    for number in range(config.views.views):
        rng = np.random.default_rng(np.random.SeedSequence((config.views.seed, index, number)))
        frame = draw_frame(body, config.views, rng)
        if frame is not None:
            yield number, frame


def draw_group(config: PushedViewsConfig, index: int) -> dict[str, np.ndarray]:
    """One body with its loads, as in the `everyday` set, and its views.

    Returns:
        What `KEPT` names, and one row a view of `observed` and `free` bits, `pitch_m` and `world_from_grid`, the pose
        of the view grid in the frame of the body grid, and `view`, its number.

    Raises:
        Dropped: The body is not that of the set, or no view shows it.
    """
    found = list(frames(config, index))
    if not found:
        raise Dropped("not_segmented")
    group = Store(Path(config.bodies)).group(index)
    return {
        **{name: group[name] for name in KEPT},
        "observed": np.stack([pack_bits(frame.view.observed) for _, frame in found]),
        "free": np.stack([pack_bits(frame.view.free) for _, frame in found]),
        "pitch_m": np.array([frame.view.grid.pitch_m for _, frame in found]),
        "world_from_grid": np.stack([frame.world_from_grid for _, frame in found]),
        "view": np.array([number for number, _ in found]),
    }


def moved_condition(condition: Condition, edge_m: float, grid: Grid) -> Condition:
    """A load told in the body grid of this edge, as it is told in another grid.

    Args:
        condition: In the body grid.
        edge_m: Of the body grid.
        grid: The other grid, posed in the frame of the body grid.
    """
    force = 10.0 ** float(condition[6]) * edge_m**2 * condition[3:6].astype(np.float64)  # of a body with E = 1
    contact_m = condition[:3].astype(np.float64) * edge_m
    return encode_condition(grid, contact_m, force, 1.0, float(condition[7]), float(condition[8]) * edge_m)


@dataclass(frozen=True)
class Push:
    """One load on one body, and one view of it.

    Attributes:
        view: Row of the view.
        condition: In the view grid.
        rest: Body at rest, bits in the body grid.
        deformed: The same body under the load.
        edge_m: Of the body grid.
    """

    view: int
    condition: Condition
    rest: UInt8[np.ndarray, " bytes"]
    deformed: UInt8[np.ndarray, " bytes"]
    edge_m: float


@dataclass(frozen=True)
class PushedViewSet:
    """Views, and for each the loads on its body."""

    observed: UInt8[np.ndarray, "n bytes"]
    free: UInt8[np.ndarray, "n bytes"]
    pitch_m: Float64[np.ndarray, " n"]
    world_from_grid: Float64[np.ndarray, "n 4 4"]
    pushes: tuple[tuple[Push, ...], ...]

    def __len__(self) -> int:
        return len(self.observed)

    @classmethod
    def load(cls, root: Path, split: str) -> PushedViewSet:
        """Read one split of a finished or growing store; `all` is every body.

        Raises:
            StoreError: It is of another store version.
        """
        columns: dict[str, list[np.ndarray]] = {"observed": [], "free": [], "pitch_m": [], "world_from_grid": []}
        pushes: list[tuple[Push, ...]] = []
        for index, group in Store(root).groups():
            if split not in ("all", split_of(index)):
                continue
            for key, parts in columns.items():
                parts.append(group[key])
            edge_m = float(group["edge_m"])
            for pitch_m, pose in zip(group["pitch_m"], group["world_from_grid"], strict=True):
                grid = Grid(float(pitch_m), pose)
                loads = zip(group["condition"], group["deformed"], strict=True)
                pushes.append(tuple(
                    Push(len(pushes), moved_condition(condition, edge_m, grid), group["rest"], deformed, edge_m)
                    for condition, deformed in loads
                ))  # fmt: skip
        return cls(pushes=tuple(pushes), **{key: np.concatenate(parts) for key, parts in columns.items()})

    def batch(self, pushes: list[Push]) -> PushedBatch:
        """Tensors of some of the pushes."""
        rows: Int[np.ndarray, " b"] = np.array([push.view for push in pushes])
        truth = [self.seen(push, push.deformed) for push in pushes]
        return PushedBatch(
            view=torch.cat([unpack(self.observed[rows]), unpack(self.free[rows])], dim=1),
            condition=torch.from_numpy(np.stack([push.condition for push in pushes])),
            truth=torch.from_numpy(np.stack(truth)).float(),
        )

    def seen(self, push: Push, bits: UInt8[np.ndarray, " bytes"]) -> Occupancy:
        """A body of the push in its view grid; what leaves that is cut off."""
        grid = Grid(float(self.pitch_m[push.view]), self.world_from_grid[push.view])
        return resample(unpack_bits(bits).astype(np.float32), Grid(push.edge_m / GRID_SIZE, np.eye(4)), grid) > 0.5


@dataclass(frozen=True)
class PushedBatch:
    """Tensors of one step, all in the view grid."""

    view: Float[Tensor, "b 2 64 64 64"]
    condition: Float[Tensor, "b 9"]
    truth: Float[Tensor, "b 64 64 64"]

    def mirrored(self) -> PushedBatch:
        """Mirror image left to right, as `ViewBatch.mirrored`."""
        condition = self.condition.clone()
        condition[:, 1] = 1.0 - condition[:, 1]
        condition[:, 4] *= -1.0
        return PushedBatch(self.view.flip(3), condition, self.truth.flip(2))
