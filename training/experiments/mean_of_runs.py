"""The mean of several runs' weights as a run of its own, to be evaluated and exported like others.

    python -m training.experiments.mean_of_runs runs/one runs/other --out runs/mean

Runs that began with the same weights and went different ways are often right where their mean is, and more steadily so.

Source: Wortsman et al., "Model soups", ICML 2022.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor


def mean_of_runs(checkpoints: Sequence[Path]) -> dict[str, Any]:
    """What a network's checkpoint holds, without optimizer: weights are the mean, all else is the last one's.

    Raises:
        ValueError: The networks are not all alike.
    """
    states: list[dict[str, Any]] = [torch.load(path, weights_only=True) for path in checkpoints]
    last = states[-1]
    if any(state["config"]["network"] != last["config"]["network"] for state in states):
        raise ValueError("the mean is of networks that are alike; these differ in their configuration")
    told = " and ".join(f"{path.parent.name} at step {s['step']}" for path, s in zip(checkpoints, states, strict=True))
    begun_from = (
        f"nothing was trained further: the mean of {told}; the last one began from {last['config']['begun_from']}"
    )
    return {
        "network": {name: _mean([state["network"][name] for state in states]) for name in last["network"]},
        "config": last["config"] | {"begun_from": begun_from},
        **{key: last[key] for key in ("step", "dataset", "code")},
    }


def _mean(tensors: Sequence[Tensor]) -> Tensor:
    """Of floating point numbers; counts stay the last one's."""
    last = tensors[-1]
    if not last.is_floating_point():
        return last
    return torch.stack([tensor.double() for tensor in tensors]).mean(dim=0).to(last.dtype)


def main(arguments: list[str] | None = None) -> int:
    """Write the checkpoint."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", type=Path, nargs="+", help="folders of runs; the last one tells data and configuration")
    parser.add_argument("--out", type=Path, required=True, help="folder of the mean")
    options = parser.parse_args(arguments)
    path = options.out / "checkpoint.pt"
    if path.exists():
        print(f"{path} is there already; choose another --out", file=sys.stderr)
        return 1
    state = mean_of_runs([run / "checkpoint.pt" for run in options.runs])
    options.out.mkdir(parents=True, exist_ok=True)
    torch.save(state, path)
    return 0


if __name__ == "__main__":
    sys.exit(main())
