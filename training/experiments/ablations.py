"""What each part of the deformation network is worth, and what it does where it was not trained.

Short runs of one length on the same data, judged on the same samples of the test split:

    python -m training.experiments.ablations --data data/everyday --out runs/ablations

Runs that are done are kept: the same command goes on from where it stopped.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch

from training.comparison import deforming
from training.configs import (
    REALTIME,
    SMALL_CRITIC,
    AdversaryConfig,
    FitDeformationConfig,
    HeldOut,
    OptimizerConfig,
)
from training.data.batches import DeformationSet
from training.fit_deformation import fit_deformation, validate
from training.networks.checkpoint import load_network
from training.networks.conditions import ConditionConfig
from training.networks.critic import CriticConfig
from training.networks.deformation import DeformationConfig
from training.networks.physnet import PhysNetConfig
from training.runs import Run

WHOLE = "whole network"

SMALL_PHYSNET = PhysNetConfig(channels=(8, 16, 32, 64), hidden=256, latent=16, condition=ConditionConfig())
"""The paper's generator, narrow enough for a CPU, with our encoding of the load."""

HELD_OUT = {
    "Poisson's ratio of 0.38 and more": HeldOut(field="poisson_ratio", low=0.38),
    "log10 of the load number of -2.13 and more": HeldOut(field="log10_load_number", low=-2.13),
    "contacts 0.28 to 0.41 above the floor": HeldOut(field="contact_z", low=0.28, high=0.41),
    "arch, bottle, bowl, chair, ring, tube": HeldOut(families=("arch", "bottle", "bowl", "chair", "ring", "tube")),
}
"""About a fifth of the samples each."""


def variants(base: FitDeformationConfig, steps: int) -> dict[str, FitDeformationConfig]:
    """By name: the whole network, what is taken from it or added, and what is held out of its training."""
    base = replace(base, steps=steps, validate_every=steps)
    assert isinstance(base.network, DeformationConfig)
    critic = AdversaryConfig(
        critic=CriticConfig(channels=SMALL_CRITIC, condition=ConditionConfig()),
        optimizer=OptimizerConfig(learning_rate=2e-4, warm_up=0, weight_decay=0.0, betas=(0.5, 0.999)),
        start=steps // 3, ramp=steps // 6, head_start=steps // 6,
    )  # fmt: skip
    light = replace(critic, beta=1 - (1 - critic.beta) / 10)
    unaided = replace(base, network=replace(base.network, prior=False))
    voxels = replace(base, network=SMALL_PHYSNET)
    return {
        WHOLE: base,
        "without skips": replace(base, network=replace(base.network, skips=False)),
        "without condition": replace(base, network=replace(base.network, conditioned=False)),
        "without prior": unaided,
        "without prior and skips": replace(unaided, network=replace(base.network, prior=False, skips=False)),
        "without prior and condition": replace(unaided, network=replace(base.network, prior=False, conditioned=False)),
        "occupancy in place of displacement, without prior": voxels,
        **{f"trained without {name}": replace(base, held_out=held) for name, held in HELD_OUT.items()},
        # Last, as a run with a critic takes fifteen times as long (that of the voxels two to three).
        "with a critic": replace(base, adversary=critic),
        "occupancy in place of displacement, without prior, with a critic": replace(voxels, adversary=critic),
        "with a critic of a tenth of the weight": replace(base, adversary=light),
        "occupancy in place of displacement, without prior, with a critic of a tenth of the weight": replace(
            voxels, adversary=light
        ),
    }


def run_all(
    configs: Mapping[str, FitDeformationConfig], data: Path, out: Path, samples: int
) -> dict[str, dict[str, Any]]:
    """Train and judge each; what was measured is in `out/ablations.json` as soon as it is known."""
    target = out / "ablations.json"
    found: dict[str, dict[str, Any]] = json.loads(target.read_text()) if target.exists() else {}
    test = DeformationSet.load(data, "test")
    for number, (name, config) in enumerate(configs.items()):
        if name in found:
            continue
        folder, started = out / f"{number:02d}", time.process_time()
        fit_deformation(data, Run(folder), config)
        seconds = time.process_time() - started
        network = deforming(load_network(folder / "checkpoint.pt")[0])
        found[name] = {"steps": config.steps, "cpu_s": seconds, **validate(network, test, samples)}
        if config.held_out:
            base = deforming(load_network(out / "00" / "checkpoint.pt")[0])
            held = test.only(config.held_out.holds(test))
            found[name]["held_out"] = {"samples": len(held), **validate(network, held, samples)}
            found[name]["held_out_trained_on"] = validate(base, held, samples)
        out.mkdir(parents=True, exist_ok=True)
        target.write_text(json.dumps(found, indent=1) + "\n")
    return found


def markdown(found: Mapping[str, Mapping[str, Any]]) -> str:
    """Two tables: of all samples, and of those that were held out."""
    lines = ["| | IoU | skill | displacement error | active latents |", "|---|---|---|---|---|"]
    for name, row in found.items():
        error = f"{row['displacement_error']:.1%}" if "displacement_error" in row else ""
        lines.append(f"| {name} | {row['iou']:.3f} | {row['skill']:.3f} | {error} | {row['active_latents']:.0f} |")
    held = {name: row for name, row in found.items() if "held_out" in row}
    if held:
        lines += ["", "| on what was held out | samples | IoU, never seen | IoU, trained on | nothing moves |"]
        lines += ["|---|---|---|---|---|"]
    for name, row in held.items():
        own, seen = row["held_out"], row["held_out_trained_on"]
        lines.append(f"| {name} | {own['samples']} | {own['iou']:.3f} | {seen['iou']:.3f} | {own['identity']:.3f} |")
    return "\n".join(lines) + "\n"


def main(arguments: list[str] | None = None, base: FitDeformationConfig = REALTIME) -> int:
    """Run what is not done yet, print the tables."""
    parser = argparse.ArgumentParser(prog="python -m training.experiments.ablations", description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the data set")
    parser.add_argument("--out", type=Path, required=True, help="folder of the runs and of what they gave")
    parser.add_argument("--steps", type=int, default=200, help="of every run")
    parser.add_argument("--bodies", type=int, default=base.bodies, help="of a batch")
    parser.add_argument("--samples", type=int, default=120, help="of the test split")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    configs = variants(replace(base, bodies=options.bodies), options.steps)
    found = run_all(configs, options.data, options.out, options.samples)
    (options.out / "ablations.md").write_text(markdown(found))
    print(markdown(found), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main())
