"""The paper's kind of network on a release of our own: a block that sinks as it gets softer."""

from dataclasses import replace

import numpy as np
import torch

from tests.training.experiments.test_released_data import sinking
from training.configs import OptimizerConfig
from training.data.physnet_2018 import grids
from training.experiments.released_correction import mean_iou
from training.experiments.released_network import BridgeConfig, BridgeGenerator, predict, reach, train_bridge

SMALL = BridgeConfig(motions=2, residuals=2, hidden=8, steps=40, batch=6)


def test_the_box_holds_all_that_is_ever_filled() -> None:
    voxels = grids(sinking().deformed)
    box = reach(voxels)
    assert voxels[(slice(None), *box)].sum() == voxels.sum()
    assert [axis.stop - axis.start for axis in box] == [10, 10, 22]


def test_an_untrained_network_answers_with_the_body_at_rest() -> None:
    rest = grids(sinking().rest[:1])[0][24:40, 24:40, 20:48]
    network = BridgeGenerator(SMALL, rest)
    assert mean_iou(predict([network], np.array([[0.5, 0.5]], np.float32)) > 0.5, rest[None]) == 1.0


def test_a_motion_moves_the_body_against_it() -> None:
    """u = (0, 0, -3) voxels everywhere: what is at z + 3 at rest is now at z."""
    rest = grids(sinking().rest[:1])[0][24:40, 24:40, 20:48]
    network = BridgeGenerator(SMALL, rest)
    with torch.no_grad():
        network.embed[-1].weight.zero_()
        network.embed[-1].bias.copy_(torch.tensor([1.0, 0.0, 0.0, 0.0]))
        network.motion.zero_()
        network.motion[0, 2] = -1.0  # learnt three times as fast as the layers: it counts threefold
    moved = predict([network], np.array([[0.5, 0.5]], np.float32)) > 0.5
    np.testing.assert_array_equal(moved[0], np.roll(rest, -3, axis=2))


def test_training_learns_what_stiffness_does() -> None:
    release = sinking()
    stiffest = slice(12, None)  # these fall by 4 to 0 voxels, the thickness of the plate
    known = grids(release.deformed[stiffest])
    box = reach(known)
    truth, rest = known[(slice(None), *box)], grids(release.rest[:1])[0][box]
    label = np.ascontiguousarray(release.label[stiffest, 1:3])
    quick = replace(SMALL, steps=80, optimizer=OptimizerConfig(learning_rate=2e-2, warm_up=8, weight_decay=0.0))
    network = train_bridge(quick, label, truth, rest, seed=0)
    still = mean_iou(np.repeat(rest[None], 5, axis=0), truth)
    assert mean_iou(predict([network], label) > 0.5, truth) > still + 0.15
