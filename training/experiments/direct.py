"""A single network from one noisy view and a load straight to the deformed shape, which the cascade must beat.

    python -m training.experiments.direct --bodies data/everyday --out runs/direct --init-from runs/reconstruction

draws views of the bodies of an `everyday` set and trains it; `benchmarks.service.cascade` puts the two side by side.
Both go on from where they stopped.
"""

from __future__ import annotations

import argparse
import csv
import functools
import sys
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import torch

from training.configs import FitConfig, OptimizerConfig
from training.data.batches import spread_rows
from training.data.generate import fill
from training.data.pushed_views import Push, PushedViewsConfig, PushedViewSet, draw_group
from training.data.store import Store
from training.evaluate import THRESHOLDS
from training.fit_loop import Learner, training_steps
from training.losses import occupancy_losses
from training.metrics import iou
from training.networks.checkpoint import take_weights
from training.networks.direct import DirectConfig, DirectNetwork
from training.runs import Run

BATCH = 16


@dataclass(frozen=True, kw_only=True)
class FitDirectConfig(FitConfig):
    """All that a run is made of.

    Attributes:
        batch: Views of a batch, each under one load on its body.
        iou_weight: As of the reconstruction.
    """

    network: DirectConfig = field(default_factory=DirectConfig)
    batch: int = 8
    iou_weight: float = 0.1


REALTIME = FitDirectConfig(optimizer=OptimizerConfig(learning_rate=1e-3, warm_up=100))


def fit_direct(data: Path, run: Run, config: FitDirectConfig, begin_from: Path | None = None) -> None:
    """Train from the start, or from the run's last checkpoint.

    Args:
        data: The pushed views.
        run: Where checkpoints go.
        config: All that it is made of.
        begin_from: Checkpoint of a reconstruction network whose weights the part that sees the view begins with.
    """
    training, validation = PushedViewSet.load(data, "train"), PushedViewSet.load(data, "validation")
    torch.manual_seed(config.seed)
    network = DirectNetwork(config.network)
    if begin_from is not None:
        config = replace(config, begun_from=take_weights(network.shape, begin_from))
        run.say(f"begins with {config.begun_from}")
    network = network.to(memory_format=network.memory_format)  # type: ignore[call-overload]
    learner = Learner(network, config.optimizer, config.steps)
    run.say(f"{len(training)} training and {len(validation)} validation views")
    for step in training_steps(
        run, config, learner.parts(), Store(data).manifest(),
        lambda: validate(network, validation, config.validation_samples),
    ):  # fmt: skip
        network.train()
        views = step.rng.choice(len(training), config.batch, replace=False)
        pushes = [training.pushes[view] for view in views]
        batch = training.batch([loads[step.rng.integers(len(loads))] for loads in pushes])
        if step.rng.random() < 0.5:
            batch = batch.mirrored()
        logits = network(batch.view, batch.condition)
        # Where a ray passed before the push there may be matter after it: nothing overrules the network.
        anywhere = torch.zeros_like(logits, dtype=torch.bool)
        entropy, overlap = occupancy_losses(logits, batch.truth, anywhere, config.alpha)
        step.losses = {"bce": entropy.item(), "soft_iou": 1 - overlap.item()}
        loss = entropy + config.iou_weight * overlap
        run.check_finite(loss, step.index)
        learner.learn(loss)


def _spread(samples: PushedViewSet, count: int) -> list[Push]:
    """An even part of all pushes."""
    every = [push for loads in samples.pushes for push in loads]
    return [every[row] for row in spread_rows(len(every), count)]


@torch.no_grad()
def validate(network: DirectNetwork, samples: PushedViewSet, count: int) -> dict[str, float]:
    """IoU in the view grid on a fixed, evenly spread subset, beside the true body at rest; and by threshold."""
    network.eval()
    pushes = _spread(samples, count)
    still, ious = [], np.zeros(len(THRESHOLDS))
    for part in np.array_split(np.arange(len(pushes)), max(1, len(pushes) // BATCH)):
        chosen = [pushes[row] for row in part]
        batch = samples.batch(chosen)
        probability = network(batch.view, batch.condition).sigmoid().numpy()
        truth = batch.truth.numpy() > 0.5
        still += [iou(samples.seen(push, push.rest), t) for push, t in zip(chosen, truth, strict=True)]
        ious += [sum(iou(p > cut, t) for p, t in zip(probability, truth, strict=True)) for cut in THRESHOLDS]
    best = int(ious.argmax())
    return {
        "iou": float(ious[best]) / len(pushes), "threshold": THRESHOLDS[best], "nothing_moves": float(np.mean(still))
    }  # fmt: skip


def trained(run_folder: Path, config: FitDirectConfig) -> tuple[DirectNetwork, float]:
    """The network of a run of this configuration, ready to answer, and its threshold at the last validation."""
    network = DirectNetwork(config.network)
    network.load_state_dict(torch.load(run_folder / "checkpoint.pt", weights_only=True)["network"])
    with (run_folder / "log.csv").open(newline="") as file:
        *_, last = csv.DictReader(file)
    return network.eval(), float(last["threshold"])


def main(arguments: list[str] | None = None, base: FitDirectConfig = REALTIME) -> int:
    """Draw what is not drawn, train what is not trained."""
    parser = argparse.ArgumentParser(
        prog="python -m training.experiments.direct", description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )  # fmt: skip
    parser.add_argument("--bodies", type=Path, required=True, help="folder of an everyday set")
    parser.add_argument("--out", type=Path, required=True, help="folder of the views and of the run")
    parser.add_argument("--init-from", type=Path, help="run of a reconstruction network to begin with")
    parser.add_argument("--steps", type=int, default=2000)
    parser.add_argument("--groups", type=int, help="the first bodies of the set only")
    options = parser.parse_args(arguments)
    torch.set_num_threads(1)
    drawn = PushedViewsConfig(str(options.bodies))
    indices = sorted(int(path.stem) for path in (options.bodies / "groups").glob("*.npz"))[: options.groups]
    views = options.out / "views"
    configuration = {"set": "pushed views", "groups": len(indices), **asdict(drawn)}
    fill(Store(views), functools.partial(draw_group, drawn), indices, 1, configuration)
    config = replace(base, steps=options.steps)
    begin_from = options.init_from / "checkpoint.pt" if options.init_from else None
    fit_direct(views, Run(options.out / "run"), config, begin_from)
    return 0


if __name__ == "__main__":
    sys.exit(main())
