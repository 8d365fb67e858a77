"""The `views` set: bodies seen by a noisy depth camera, through the service's own perception.

A draw is held to what a robot may meet, at a tenth of a second a view: the body is sampled once on a grid, from which
its views are rendered and its truth is read.
"""

from __future__ import annotations

import numpy as np

from service.core.arrays import Occupancy
from service.core.grids import pack_bits
from service.core.voxels import VoxelView
from training.data.frames import draw_view
from training.data.generate import Dropped
from training.data.views_config import HOLLOW, ROUND_FOOTED, TIPPABLE, ViewsConfig
from training.simulation.distance_grid import DistanceGrid
from training.simulation.families import sample_shape
from training.simulation.grid_body import sampled, scaled, tipped
from training.simulation.shapes import Shape
from training.simulation.undercut import stands, undercut

UNDERCUT_TRIES = 4
"""Shares tried, each half of the one before, until a body stands on what is left of its foot."""


def draw_group(config: ViewsConfig, index: int) -> dict[str, np.ndarray]:
    """One body with all its views.

    Returns:
        `family`, `thin` (whether its walls are as thin as real ones), `pose` (quarter turns: 0 upright, 1 lying,
        2 upside down), and one row a view of `observed`, `free` and `truth` bits in the view grid, and `sample` (view
        number, longest edge in metres).

    Raises:
        Dropped: There was no body, or none of its views could be segmented.
    """
    rng = np.random.default_rng(np.random.SeedSequence((config.seed, index)))
    family = config.families[rng.integers(len(config.families))]
    thin = bool(rng.random() < (config.thin_hollow if family in HOLLOW else config.thin))
    pose = int(rng.integers(1, 3)) if family in TIPPABLE and rng.random() < config.tipped else 0
    try:
        body = _sized(_stretched(sample_shape(family, rng, thin), config, rng), pose, config, rng)
        if family in ROUND_FOOTED and config.undercut > 0.0 and rng.random() < config.undercut:
            body = _undercut(body, config, rng)
    except (RuntimeError, ValueError) as error:  # none stood in as many tries as it is given, or its walls are lost
        raise Dropped("no_shape") from error
    rows: list[tuple[VoxelView, Occupancy, float]] = []
    for number in range(config.views):
        # A generator of its own for each view: one that fails must not shift the others.
        view = draw_view(body, config, np.random.default_rng(np.random.SeedSequence((config.seed, index, number))))
        if view is not None:
            rows.append((*view, number))
    if not rows:
        raise Dropped("not_segmented")
    return {
        "family": np.array(family),
        "thin": np.array(thin),
        "pose": np.array(pose, np.int8),
        "observed": np.stack([pack_bits(view.observed) for view, _, _ in rows]),
        "free": np.stack([pack_bits(view.free) for view, _, _ in rows]),
        "truth": np.stack([pack_bits(truth) for _, truth, _ in rows]),
        "sample": np.array([[number, _longest(body)] for _, _, number in rows], np.float32),
    }


def _stretched(shape: Shape, config: ViewsConfig, rng: np.random.Generator) -> Shape:
    """The body taller or flatter, and a little wider or narrower."""
    if rng.random() >= config.stretch:
        return shape
    low, high = np.log(config.stretched)
    x, y, z = np.exp(rng.uniform(low, high, 3) * (0.5, 0.5, 1.0))
    return shape.stretched((float(x), float(y), float(z)))


def _sized(shape: Shape, pose: int, config: ViewsConfig, rng: np.random.Generator) -> DistanceGrid:
    """The body sampled on a grid, in its pose and size, on z = 0 about the z axis."""
    grid = tipped(sampled(shape), pose)
    return scaled(grid, float(np.exp(rng.uniform(*np.log(config.size_m)))) / _longest(grid))


def _undercut(body: DistanceGrid, config: ViewsConfig, rng: np.random.Generator) -> DistanceGrid:
    """The body narrower towards the ground as far as it still stands."""
    (left, right), (front, back), (low, high) = body.bounds
    half_m = min(right - left, back - front) / 2
    share, height = rng.uniform(*config.undercut_share), rng.uniform(*config.undercut_height)
    for _ in range(UNDERCUT_TRIES):
        cut = undercut(body, share, min(height * share * half_m, high - low))
        if stands(cut, body):
            return cut
        share /= 2
    return body


def _longest(grid: DistanceGrid) -> float:
    return float((grid.bounds[:, 1] - grid.bounds[:, 0]).max())
