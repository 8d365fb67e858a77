"""An `everyday` set of three blocks that can be drawn again from its seed, sheared over their clamp."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from service.core.grids import Grid, pack_bits
from tests.training.tiny import sheared
from training.data.body_cube import place_in_body_grid
from training.data.pushed_views import PushedViewsConfig, draw_group
from training.data.store import Store
from training.data.views_config import ViewsConfig
from training.metrics import iou
from training.simulation.families import sample_shape
from training.simulation.grid_body import filled, sampled

GROUPS = (0, 1, 3)
"""One each to validate, to test and to train on."""
EDGE_M = 0.2
YOUNG_MODULUS_PA = 1e5
LOAD_NUMBER = 10.0**-2.5
VIEWS = ViewsConfig(views=1, masked=1.0, clutter=0.0, table=0.0)


def write_bodies(root: Path) -> PushedViewsConfig:
    """The set, and how its bodies are seen: alone on an endless table."""
    store = Store(root)
    for index in GROUPS:
        rng = np.random.default_rng(np.random.SeedSequence((0, index)))
        rng.integers(1)  # which of the one family
        cube = place_in_body_grid(sample_shape("box", rng, cells=24))
        rest = filled(sampled(cube.shape), Grid(1.0 / 64, np.eye(4)))
        deformed = [sheared(rest, np.array([shift, 0.0, 0.0]))[0] for shift in (0.1, 0.2)]
        top = (np.flatnonzero(rest.any(axis=(0, 1)))[-1] + 1) / 64
        condition = np.array([0.5, 0.5, top, 1.0, 0.0, 0.0, np.log10(LOAD_NUMBER), 0.3, 0.1], np.float32)
        store.write_group(
            index,
            {
                "family": np.array("box"), "edge_m": np.array(EDGE_M), "rest": pack_bits(rest),
                "condition": np.stack([condition] * 2), "deformed": np.stack([pack_bits(body) for body in deformed]),
                "identity_iou": np.array([iou(rest, body) for body in deformed], np.float32),
                "young_modulus_pa": np.full(2, YOUNG_MODULUS_PA),
                "force_n": np.full(2, LOAD_NUMBER * YOUNG_MODULUS_PA * EDGE_M**2),
                "sample": np.array([[0, 0.5], [0, 1.0]], np.float32),
            },
        )  # fmt: skip
    store.write_manifest({"set": "everyday", "seed": 0, "families": ["box"], "cells": 24, "vessel_cells": 32})
    return PushedViewsConfig(str(root), VIEWS)


def write_views(root: Path, config: PushedViewsConfig) -> Path:
    """Every body of the set as it is seen."""
    store = Store(root)
    for index in GROUPS:
        store.write_group(index, draw_group(config, index))
    store.write_manifest({"set": "pushed views"})
    return root
