import dataclasses
from pathlib import Path

import numpy as np
import pytest

from tests.training import tiny
from training.configs import (
    DEFORMATION_PRESETS,
    KL_PER_VOXEL,
    RECONSTRUCTION_PRESETS,
    ConfigError,
    HeldOut,
    chosen,
)
from training.data.batches import DeformationSet


def test_the_papers_numbers() -> None:
    """Section 4.2, and what the released code adds."""
    paper = DEFORMATION_PRESETS["paper"]
    assert (paper.optimizer.learning_rate, paper.optimizer.betas) == (5e-5, (0.5, 0.999))
    assert (paper.bodies * paper.loads, paper.alpha) == (8, 0.85)
    assert paper.adversary is not None
    assert (paper.adversary.penalty, paper.adversary.beta) == (10.0, 0.95)
    assert pytest.approx(1 / 262144) == KL_PER_VOXEL == paper.kl_weight


def test_a_command_line_changes_what_it_names_alone() -> None:
    preset = RECONSTRUCTION_PRESETS["realtime"]
    changed = chosen(RECONSTRUCTION_PRESETS, "realtime", steps=7, learning_rate=1e-4, seed=None)
    assert changed == dataclasses.replace(
        preset, steps=7, optimizer=dataclasses.replace(preset.optimizer, learning_rate=1e-4)
    )
    assert chosen(RECONSTRUCTION_PRESETS, "realtime", None, None, None) == preset


def test_an_unknown_preset_is_answered_with_those_that_are_known() -> None:
    with pytest.raises(ConfigError, match="no preset huge; choose one of realtime, realtime-gan, paper"):
        chosen(RECONSTRUCTION_PRESETS, "huge", None, None, None)


def test_what_is_held_out_is_a_family_or_a_band(tmp_path: Path) -> None:
    samples = DeformationSet.load(tiny.write_deformations(tmp_path), "train", prior=False)
    assert HeldOut(families=("box",)).holds(samples).all()
    assert not HeldOut(families=("bowl",)).holds(samples).any()
    stronger = HeldOut(field="log10_load_number", low=-2.3).holds(samples)
    np.testing.assert_array_equal(stronger, samples.condition[:, 6] > -2.3)
    assert 0 < stronger.sum() < len(samples)
