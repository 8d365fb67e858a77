"""Ours on the authors' release: a solve whose unknowns were found, corrected by kriging between training samples."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Bool, Float32, Float64, Int

from training.data.physnet_2018 import soft_split
from training.experiments.released_bridge import SWEEPS, BridgeModel, Labels, fit_bridge
from training.metrics import iou

SOFT_SHARE = 0.3
"""Of the training samples, left out to choose a recipe for those that are softer still."""
FULL_LAYER = 0.75
"""Layers across the bridge that hold less than this of the fullest one are faces on which the centres of voxels lie."""
STRAINS = np.array([-0.03, -0.01, -0.003, -0.001, 0.001, 0.003, 0.01, 0.03])
"""Bins of the strain along members: what is pressed together swells sideways and fills its face."""

Kind: TypeAlias = Literal["random", "soft"]
Flat: TypeAlias = Float32[np.ndarray, "n voxels"]


@dataclass(frozen=True)
class Recipe:
    """How the solve and the training samples are put together.

    Attributes:
        around: What is answered far from all samples: the solve, or the mean of the training samples.
        load: How far in the logarithm of the load number samples tell of each other.
        poisson: The same in Poisson's ratio as labelled.
        noise: Variance of a sample that its neighbours tell nothing of, as a share of all.
    """

    around: Literal["solve", "mean"]
    load: float
    poisson: float
    noise: float


_AROUND: tuple[Literal["solve", "mean"], ...] = ("solve", "mean")
RECIPES = tuple(
    Recipe(around, load, poisson, noise)
    for around, load, poisson, noise in itertools.product(
        _AROUND, (0.05, 0.1, 0.2, 0.4), (0.7, 1.5), (0.05, 0.15)
    )
)


@dataclass(frozen=True, eq=False)
class Solve:
    """The frame as voxels: its section in every full layer across the bridge, its faces as full as samples were.

    Attributes:
        model: The fitted frame.
        full: Layers across the bridge that the section fills.
        faces: Layers on its two sides.
        share: Part of the voxels of a face that is filled, by the strain along the member.
    """

    model: BridgeModel
    full: slice
    faces: tuple[int, ...]
    share: Float32[np.ndarray, " bins"]

    @classmethod
    def fit(
        cls, label: Labels, deformed: Bool[np.ndarray, "n x y z"], rest: Bool[np.ndarray, "x y z"],
        sweeps: int = SWEEPS,
    ) -> Solve:  # fmt: skip
        """Find the frame, and how full faces are, from training samples."""
        full, faces = layers(rest)
        model = fit_bridge(label, middle(deformed, full), middle(rest[None], full)[0], sweeps)
        section, strain = model.shapes(label)
        bins = np.digitize(strain, STRAINS)
        share = np.full(len(STRAINS) + 1, 0.5, np.float32)
        if faces:
            filled = deformed[:, :, list(faces)].mean(axis=2)
            for number in np.unique(bins[section]):
                share[number] = filled[section & (bins == number)].mean()
        return cls(model, full, faces, share)

    def __call__(self, label: Labels) -> Float32[np.ndarray, "n x y z"]:
        """Probability of every voxel."""
        section, strain = self.model.shapes(label)
        grid = np.zeros((len(label), 64, 64, 64), np.float32)
        grid[:, :, self.full] = section[:, :, None]
        for face in self.faces:
            grid[:, :, face] = np.where(section, self.share[np.digitize(strain, STRAINS)], 0.0)
        return grid


def layers(rest: Bool[np.ndarray, "x y z"]) -> tuple[slice, tuple[int, ...]]:
    """Layers across the bridge that are full, and the ragged ones on its sides."""
    count = rest.sum(axis=(0, 2))
    full = np.flatnonzero(count >= FULL_LAYER * count.max())
    ragged = [int(y) for y in np.flatnonzero(count) if not full[0] <= y <= full[-1]]
    return slice(int(full[0]), int(full[-1]) + 1), tuple(ragged)


def middle(voxels: Bool[np.ndarray, "n x y z"], full: slice) -> Bool[np.ndarray, "n x z"]:
    """The section that most of the full layers show."""
    return np.asarray(voxels[:, :, full].mean(axis=2) > 0.5)


class Kriging:
    """Gaussian-process regression of every voxel between training samples, over load number and Poisson's ratio.

    Args:
        recipe: See there.
        place: Logarithm of the load number, and Poisson's ratio, of the training samples.
        truth: Their voxels.
        around: What the solve says of them.

    Source: Rasmussen and Williams, Gaussian Processes for Machine Learning (2006), 2.23 and, for leaving out, 5.12.
    """

    def __init__(self, recipe: Recipe, place: Float64[np.ndarray, "n 2"], truth: Flat, around: Flat) -> None:
        self.recipe, self.place = recipe, place
        self.mean = truth.mean(axis=0) if recipe.around == "mean" else None
        self.truth = truth
        covariance = self.likeness(place) + recipe.noise * np.eye(len(place))
        self.inverse = np.linalg.inv(covariance).astype(np.float32)
        self.weight = self.inverse @ (truth - (around if self.mean is None else self.mean))

    def likeness(self, place: Float64[np.ndarray, "m 2"]) -> Float64[np.ndarray, "m n"]:
        """Covariance with the training samples: exponential, as of edges that pass a voxel at some load."""
        away = (place[:, None] - self.place) / np.array([self.recipe.load, self.recipe.poisson])
        return np.asarray(np.exp(-np.hypot(away[..., 0], away[..., 1])))

    def __call__(
        self, place: Float64[np.ndarray, "m 2"], around: Float32[np.ndarray, "m voxels"]
    ) -> Float32[np.ndarray, "m voxels"]:
        """Probabilities, a little outside of [0, 1] at times."""
        start = around if self.mean is None else self.mean
        return np.asarray(start + self.likeness(place).astype(np.float32) @ self.weight)

    def left_out(self) -> Flat:
        """What each training sample would be said to be by the others."""
        return np.asarray(self.truth - self.weight / np.diag(self.inverse)[:, None])


@dataclass(frozen=True, eq=False)
class Ours:
    """A solve and the recipe by which it is corrected."""

    solve: Solve
    recipe: Recipe

    def __call__(
        self, label: Float32[np.ndarray, "m 2"], known: Labels, truth: Bool[np.ndarray, "n x y z"]
    ) -> Float32[np.ndarray, "m x y z"]:
        """Probabilities for the labels, from the training samples."""
        around, of_known = self.solve(label), self.solve(known)
        voxels = np.flatnonzero(truth.any(axis=0).ravel() | (around > 0).any(axis=0).ravel())
        kriging = Kriging(self.recipe, self.place(known), flat(truth, voxels), flat(of_known, voxels))
        answer = np.zeros((len(label), 64**3), np.float32)
        answer[:, voxels] = kriging(self.place(label), flat(around, voxels))
        return answer.reshape(-1, 64, 64, 64)

    def place(self, label: Labels) -> Float64[np.ndarray, "n 2"]:
        """Where a label lies for kriging."""
        return place(self.solve, label)


def place(solve: Solve, label: Labels) -> Float64[np.ndarray, "n 2"]:
    """Logarithm of the load number, and Poisson's ratio."""
    return np.stack([solve.model.load_number(label), label[:, 1].astype(np.float64)], axis=1)


def flat(grid: np.ndarray, voxels: Int[np.ndarray, " voxels"]) -> Flat:
    """Some voxels of every grid."""
    return np.ascontiguousarray(grid.reshape(len(grid), -1)[:, voxels], np.float32)


def train_ours(
    kind: Kind, label: Labels, deformed: Bool[np.ndarray, "n x y z"], rest: Bool[np.ndarray, "x y z"],
    recipes: Sequence[Recipe] = RECIPES, sweeps: int = SWEEPS,
) -> Ours:  # fmt: skip
    """Fit the solve and choose the recipe, by validation of the kind that the test is of, on training samples alone.

    Where the test is random each sample is left out of the kriging once. Where it is the softest samples, the softest
    of the training samples are left out, of the solve as well, and the solve is then fitted again to all.
    """
    if kind == "random":
        solve = Solve.fit(label, deformed, rest, sweeps)
        around = solve(label)
        voxels = np.flatnonzero(deformed.any(axis=0).ravel() | (around > 0).any(axis=0).ravel())
        truth, before = flat(deformed, voxels), flat(around, voxels)
        scores = [
            mean_iou(Kriging(recipe, place(solve, label), truth, before).left_out() > 0.5, truth > 0.5)
            for recipe in recipes
        ]
        return Ours(solve, recipes[int(np.argmax(scores))])
    known, held = soft_split(label[:, 0], round(SOFT_SHARE * len(label)))
    inner = Solve.fit(label[known], deformed[known], rest, sweeps)
    scores = [
        mean_iou(Ours(inner, recipe)(label[held], label[known], deformed[known]) > 0.5, deformed[held])
        for recipe in recipes
    ]
    return Ours(Solve.fit(label, deformed, rest, sweeps), recipes[int(np.argmax(scores))])


def mean_iou(answer: Bool[np.ndarray, "n *grid"], truth: Bool[np.ndarray, "n *grid"]) -> float:
    """Mean over the samples."""
    return float(np.mean([iou(a, t) for a, t in zip(answer, truth, strict=True)]))
