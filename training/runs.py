"""A training run on disk: checkpoints that resume exactly, a log one can plot, and progress one can read."""

from __future__ import annotations

import csv
import dataclasses
import os
import pickle
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

import torch
from torch import Tensor
from torch.utils.tensorboard import SummaryWriter

from training.data.store import code_version


class RunError(Exception):
    """A run cannot go on; the message says what to do."""


@runtime_checkable
class Stateful(Protocol):
    """Whatever a checkpoint keeps: a network, an optimizer, a schedule, a critic with its own."""

    def state_dict(self) -> dict[str, Any]: ...
    def load_state_dict(self, state_dict: dict[str, Any], /) -> object: ...


class Run:
    """`runs/<name>/`: checkpoint.pt, log.csv, and event files for TensorBoard.

    Args:
        root: Folder of this run; made if need be.
        print_every: Seconds between lines of progress.
        checkpoint_every: Seconds after which a checkpoint is due even where no validation is.
    """

    def __init__(self, root: Path, print_every: float = 10.0, checkpoint_every: float = 120.0) -> None:
        self.root = root
        self.root.mkdir(parents=True, exist_ok=True)
        self._print_every = print_every
        self._printed = 0.0
        self._checkpoint_every = checkpoint_every
        self._checkpointed = time.monotonic()
        self._dataset: dict[str, Any] = {}
        self._code = code_version()
        self._curves: SummaryWriter | None = None
        self._first = 0

    @property
    def checkpoint_path(self) -> Path:
        return self.root / "checkpoint.pt"

    def resume(self, parts: Mapping[str, Stateful], config: Any, dataset: dict[str, Any]) -> int:
        """Load the last checkpoint into its parts, if there is one, and return the step to go on from.

        What was logged after that checkpoint is forgotten: it will be logged again.

        Raises:
            RunError: The checkpoint is of another configuration or data set, or cannot be read.
        """
        self._dataset = dataset
        if not self.checkpoint_path.exists():
            return 0
        try:
            state = torch.load(self.checkpoint_path, weights_only=True)
        except (RuntimeError, EOFError, KeyError, pickle.UnpicklingError) as error:
            raise RunError(f"{self.checkpoint_path} cannot be read ({error}); choose another --run") from error
        # The data set first: a network's configuration may hold figures of its data, and so differ with it.
        if state["dataset"]["digest"] != dataset["digest"]:
            raise RunError(f"{self.checkpoint_path} was trained on another data set; choose another --run")
        wanted = dataclasses.asdict(config)
        different = [key for key in wanted if state["config"].get(key) != _plain(wanted[key])]
        if different:
            raise RunError(
                f"{self.checkpoint_path} was trained with another {', '.join(different)}; "
                "choose another --run or the same configuration"
            )
        for name, part in parts.items():
            part.load_state_dict(state[name])
        if state.get("code") != self._code:
            self.say(f"the code has changed since the checkpoint: {state.get('code')} then, {self._code} now")
        self._first = int(state["step"])
        self._forget_after(self._first)
        self.say(f"going on from step {self._first}")
        return self._first

    def checkpoint_due(self) -> bool:
        """Whether the last checkpoint is so old that losing what came after it would hurt."""
        return time.monotonic() - self._checkpointed >= self._checkpoint_every

    def checkpoint(self, step: int, parts: Mapping[str, Stateful], config: Any) -> None:
        """Write everything that `resume` needs, whole or not at all.

        Raises:
            RunError: It cannot be written, on a full disk for instance; the last one stays.
        """
        partial = self.checkpoint_path.with_suffix(".partial")
        state = {name: part.state_dict() for name, part in parts.items()}
        about = {
            "step": step, "config": _plain(dataclasses.asdict(config)), "dataset": self._dataset, "code": self._code
        }  # fmt: skip
        try:
            torch.save(state | about, partial)
            os.replace(partial, self.checkpoint_path)
        except (OSError, RuntimeError) as error:
            partial.unlink(missing_ok=True)
            raise RunError(
                f"step {step} cannot be written ({error}); the last checkpoint is kept: {self.checkpoint_path}"
            ) from error
        self._checkpointed = time.monotonic()

    def check_finite(self, loss: Tensor, step: int) -> None:
        """Raises: RunError: The loss is NaN or infinite; the last good checkpoint stays."""
        if not torch.isfinite(loss):
            raise RunError(
                f"the loss is {loss.item()} at step {step}; the last checkpoint is kept: {self.checkpoint_path}"
            )

    def log(self, step: int, figures: dict[str, float]) -> None:
        """One row of validation figures to log.csv, to the curves and to the terminal."""
        path = self.root / "log.csv"
        new = not path.exists()
        with path.open("a", newline="") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(["step", *figures])
            writer.writerow([step, *(f"{value:.6f}" for value in figures.values())])
        self._plot("validation", step, figures)
        self.say(f"step {step}: " + "  ".join(f"{name} {value:.4f}" for name, value in figures.items()))

    def close(self) -> None:
        """Put the curves on disk."""
        if self._curves is not None:
            self._curves.close()
            self._curves = None

    def _plot(self, group: str, step: int, figures: dict[str, float]) -> None:
        if self._curves is None:
            # Steps that a killed run plotted after its last checkpoint are hidden.
            self._curves = SummaryWriter(str(self.root), purge_step=self._first or None)
        for name, value in figures.items():
            self._curves.add_scalar(f"{group}/{name}", value, step)

    def _forget_after(self, step: int) -> None:
        path = self.root / "log.csv"
        if not path.exists():
            return
        with path.open(newline="") as file:
            header, *rows = csv.reader(file)
        with path.open("w", newline="") as file:
            csv.writer(file).writerows([header, *(row for row in rows if int(row[0]) <= step)])

    def progress(self, done: int, total: int, first: int, started: float, losses: dict[str, float]) -> None:
        """A line and a point of the curves every few seconds: step, rate, time left, losses."""
        now = time.monotonic()
        if now - self._printed < self._print_every:
            return
        self._printed = now
        rate = (done - first) / max(now - started, 1e-9)
        terms = "  ".join(f"{name} {value:.4f}" for name, value in losses.items())
        self._plot("training", done, losses)
        self.say(f"{done}/{total}  {rate:.2f} steps/s  {(total - done) / rate / 60:.0f} min left  {terms}")

    def say(self, line: str) -> None:
        print(f"[{self.root.name}] {line}", file=sys.stderr, flush=True)


def _plain(value: Any) -> Any:
    """Tuples as lists, so that a configuration compares equal to the one read back."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    return value
