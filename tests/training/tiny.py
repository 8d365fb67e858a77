"""Networks of a few channels and data sets of a few boxes: everything real, in a second on one core."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from service.core.grids import pack_bits
from service.core.lookup import warp
from training.configs import AdversaryConfig, FitDeformationConfig, FitReconstructionConfig, OptimizerConfig
from training.data.samples import Material, Outcome, Sample, group_of
from training.data.store import STORE_VERSION, Store
from training.networks.conditions import ConditionConfig
from training.networks.critic import CriticConfig
from training.networks.deformation import DeformationConfig, DeformationNetwork
from training.networks.physnet import PhysNetConfig
from training.networks.recgan import RecGanConfig
from training.networks.reconstruction import ReconstructionConfig, ReconstructionNetwork
from training.runs import Run
from training.simulation.clamp import Reaction
from training.simulation.loads import Load
from training.simulation.rasterise import Rasterised

# Tests share the machine with whatever else runs on it.
torch.set_num_threads(1)

DEFORMATION = DeformationConfig(
    channels=(4, 4, 4), encoder_blocks=(1, 0, 0), generator_blocks=(1, 1), latent=3, condition=8
)
RECONSTRUCTION = ReconstructionConfig(channels=(4, 4, 4, 4), blocks=(0, 1, 0, 0))
OPTIMIZER = OptimizerConfig(warm_up=2)
FIT_DEFORMATION = FitDeformationConfig(
    network=DEFORMATION, optimizer=OPTIMIZER, bodies=2, loads=1, steps=6, points=64, validate_every=3,
    validation_samples=2,
)  # fmt: skip
FIT_RECONSTRUCTION = FitReconstructionConfig(
    network=RECONSTRUCTION, optimizer=OPTIMIZER, batch=2, steps=6, validate_every=3, validation_samples=2
)

PHYSNET = PhysNetConfig(channels=(2, 2, 3, 4), hidden=6, latent=3)
RECGAN = RecGanConfig(channels=(2, 2, 3, 4), hidden=6)


def adversary(condition: ConditionConfig | None, given_channels: int = 1) -> AdversaryConfig:
    """A critic that trains from the second step and counts from the third."""
    critic = CriticConfig(given_channels=given_channels, channels=(2, 2, 2, 2), condition=condition)
    return AdversaryConfig(
        critic=critic, optimizer=OptimizerConfig(learning_rate=1e-3, warm_up=0, betas=(0.5, 0.999)),
        start=2, ramp=2, head_start=1,
    )  # fmt: skip


GROUPS = (0, 1, 2, 3, 4, 5)
"""Group 0 validates, 1 and 2 test, the rest train (`training.data.batches.split_of`)."""

SHEAR = 60.0
"""Slope of the displacement over the height, for a load number of 1."""

CENTRES = (np.indices((64, 64, 64), dtype=np.float32) + 0.5) / 64
NODES = (np.indices((32, 32, 32), dtype=np.float32) + 0.5) / 32


def box(group: int) -> np.ndarray:
    """A block standing on the floor, another one for each group."""
    half = np.array([0.20 + 0.02 * group, 0.12 + 0.01 * group])
    x, y, z = CENTRES
    return (np.abs(x - 0.5) < half[0]) & (np.abs(y - 0.5) < half[1]) & (z < 0.3 + 0.05 * group)


def sheared(rest: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The body sheared over its clamp by u(y) = shift·z, and the field, NaN outside the deformed body."""
    backward = shift.astype(np.float32)[:, None, None, None] * CENTRES[2]
    deformed = warp(rest, shift.astype(np.float32)[:, None, None, None] * NODES[2]) > 0.5
    return deformed, np.where(deformed, backward, np.nan).astype(np.float32)


def deformation_group(group: int) -> dict[str, np.ndarray]:
    """One block, pushed sideways on its top at two strengths."""
    rest = box(group)
    height = 0.3 + 0.05 * group
    samples = []
    for step, log_load in enumerate((-2.5, -2.2)):
        shift = np.array([SHEAR * 10.0**log_load, 0.0, 0.0])
        deformed, backward = sheared(rest, shift)
        forward = shift.astype(np.float32)[:, None, None, None] * CENTRES[2]
        result = Rasterised(
            deformed, np.flatnonzero(deformed), np.ascontiguousarray(backward[:, deformed].T), np.flatnonzero(rest),
            np.ascontiguousarray(forward[:, rest].T), float(shift[0] * height),
        )  # fmt: skip
        load = Load(np.array([0.5, 0.5, height]), np.array([1.0, 0.0, 0.0]), 10.0**log_load, 0.1)
        reaction = Reaction(-load.load_number * load.direction, np.zeros(3))
        outcome = Outcome("linear", 1e-4, np.nan, reaction, CENTRES[2][rest].astype(np.float64))
        samples.append(Sample.of(rest, result, load, Material(1e5, 0.3, 0.2), outcome, (0, float(step))))
    return group_of("box", rest, 0.2, samples)


def view_group(group: int) -> dict[str, np.ndarray]:
    """One block seen from -x: its front face is observed, what lies before it is free."""
    truth = box(group)
    first = np.argmax(truth.any(axis=(1, 2)))
    observed, free = np.zeros_like(truth), np.zeros_like(truth)
    observed[first] = truth[first]
    free[:first] = True
    one = {"observed": pack_bits(observed), "free": pack_bits(free), "truth": pack_bits(truth)}
    return {
        "family": np.array("box"),
        **{key: np.stack([bits, bits]) for key, bits in one.items()},
        "sample": np.array([[0, 0.1], [1, 0.1]], np.float32),
    }


def write_deformations(root: Path) -> Path:
    store = Store(root)
    for group in GROUPS:
        store.write_group(group, deformation_group(group))
    store.write_manifest({"set": "boxes", "groups": len(GROUPS)})
    return root


def write_views(root: Path) -> Path:
    store = Store(root)
    for group in GROUPS:
        store.write_group(group, view_group(group))
    store.write_manifest({"set": "box views", "groups": len(GROUPS)})
    return root


def deformation_network(seed: int = 0) -> DeformationNetwork:
    """Random weights, those of the silent last layers too, with running statistics of a few passes, ready to answer."""
    torch.manual_seed(seed)
    network = DeformationNetwork(DEFORMATION)
    for layer in network.generator.last_layers:
        torch.nn.init.normal_(layer.weight, std=0.3)
        torch.nn.init.normal_(layer.bias, std=0.3)
    with torch.no_grad():
        for _ in range(3):
            noise = torch.randn(2, DEFORMATION.latent)
            network(torch.rand(2, 1, 64, 64, 64).round(), conditions(2), noise, priors(2))
    return network.eval()


def reconstruction_network(seed: int = 0) -> ReconstructionNetwork:
    torch.manual_seed(seed)
    network = ReconstructionNetwork(RECONSTRUCTION)
    with torch.no_grad():
        for _ in range(3):
            network(torch.rand(2, 2, 64, 64, 64).round())
    return network.eval()


def conditions(count: int, log_load: float = -2.5) -> torch.Tensor:
    """Pushes along x on different places, all else equal."""
    rows = [[0.3 + 0.4 * i / max(count - 1, 1), 0.5, 0.4, 1.0, 0.0, 0.0, log_load, 0.3, 0.1] for i in range(count)]
    return torch.tensor(rows)


def priors(count: int) -> torch.Tensor:
    """Coarse solves that bend what stands on the floor along x, each farther than the one before."""
    height = (torch.arange(16) + 0.5) / 16
    field = torch.zeros(count, 3, 16, 16, 16)
    field[:, 0] = 0.05 * height**2 * torch.arange(1, count + 1)[:, None, None, None]
    return field


DATASET = {
    "store_version": STORE_VERSION,
    "configuration": {"set": "boxes", "seed": 0},
    "code": "0000000",
    "groups": len(GROUPS),
    "samples": 2 * len(GROUPS),
    "dropped": {},
    "digest": "sha256:0",
}


def save_checkpoint(
    network: nn.Module, config: object, root: Path, dataset: dict[str, Any] | None = None
) -> Path:
    """A checkpoint as a run writes it after step 7, on a data set of this manifest."""
    run = Run(root)
    optimizer = torch.optim.AdamW(network.parameters())
    schedule = torch.optim.lr_scheduler.ConstantLR(optimizer)
    parts = {"network": network, "optimizer": optimizer, "schedule": schedule}
    run.resume(parts, config, dataset or DATASET)
    run.checkpoint(7, parts, config)
    return run.checkpoint_path
