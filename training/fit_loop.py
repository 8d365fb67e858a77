"""What both training loops share: a learner, and steps that resume, report, validate and stop where they must."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from training.configs import FitConfig, OptimizerConfig
from training.runs import Run, Stateful


class Learner:
    """A network with its optimizer and the schedule of its learning rate."""

    def __init__(self, network: nn.Module, config: OptimizerConfig, steps: int) -> None:
        self.network = network
        self.optimizer = torch.optim.AdamW(
            network.parameters(), lr=config.learning_rate, betas=config.betas, weight_decay=config.weight_decay,
            fused=True,
        )
        self.schedule: torch.optim.lr_scheduler.LRScheduler
        if config.warm_up:
            rise = min(config.warm_up / steps, 0.5)  # a run shorter than its warm-up is a trial, not an error
            self.schedule = torch.optim.lr_scheduler.OneCycleLR(
                self.optimizer, config.learning_rate, total_steps=steps, pct_start=rise, cycle_momentum=False
            )
        else:
            self.schedule = torch.optim.lr_scheduler.ConstantLR(self.optimizer, factor=1.0)
        self._clip = config.clip

    def learn(self, loss: Tensor) -> None:
        """One step down the gradient."""
        self.optimizer.zero_grad(set_to_none=True)
        torch.autograd.backward(loss, inputs=list(self.network.parameters()))
        if self._clip is not None:
            torch.nn.utils.clip_grad_norm_(self.network.parameters(), self._clip)
        self.optimizer.step()
        self.schedule.step()

    def parts(self) -> dict[str, Stateful]:
        """What a checkpoint keeps of it."""
        return {"network": self.network, "optimizer": self.optimizer, "schedule": self.schedule}

    def state_dict(self) -> dict[str, Any]:
        return {name: part.state_dict() for name, part in self.parts().items()}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        for name, part in self.parts().items():
            part.load_state_dict(state[name])


@dataclass
class Step:
    """One step of a run: the body of the loop reads its chance and leaves its losses.

    Attributes:
        index: From 0.
        rng: Chance of this step alone, as torch's generator is seeded for it too.
        losses: For the progress line and the curves.
    """

    index: int
    rng: np.random.Generator
    losses: dict[str, float] = field(default_factory=dict)


def training_steps(
    run: Run,
    config: FitConfig,
    parts: Mapping[str, Stateful],
    dataset: dict[str, Any],
    validate: Callable[[], dict[str, float]],
) -> Iterator[Step]:
    """The steps that are left of a run; after each of them what is due: progress, validation, a checkpoint.

    Everything random of a step comes from (seed, step): a resumed run repeats what an unbroken one does.

    Raises:
        RunError: The run was begun with another configuration or data set.
    """
    first = run.resume(parts, config, dataset)
    started = time.monotonic()
    try:
        for index in range(first, config.steps):
            torch.manual_seed(config.seed * 1_000_003 + index)
            step = Step(index, np.random.default_rng((config.seed, index)))
            yield step
            done = index + 1
            run.progress(done, config.steps, first, started, step.losses)
            if done % config.validate_every == 0 or done == config.steps:
                run.log(done, validate())
                run.checkpoint(done, parts, config)
            elif run.checkpoint_due():
                run.checkpoint(done, parts, config)
    finally:
        run.close()
