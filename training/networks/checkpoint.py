"""From a checkpoint back to the network it was taken of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import nn

from training.networks.build import build_saved
from training.networks.growth import grow


def take_weights(network: nn.Module, checkpoint: Path) -> str:
    """Give a network the weights of another run wherever it is as large or larger (`grow`).

    Returns:
        What was taken: run, step, data and the number of tensors.

    Raises:
        ValueError: Nothing fits.
    """
    state: dict[str, Any] = torch.load(checkpoint, weights_only=True)
    taken = grow(network, state["network"])
    if not taken:
        raise ValueError(f"no weight of {checkpoint} fits this network")
    return (
        f"{checkpoint.parent.name} at step {state['step']}, trained on {state['dataset']['digest']}: "
        f"{len(taken)} of {len(network.state_dict())} tensors"
    )


def load_network(checkpoint: Path) -> tuple[nn.Module, dict[str, Any]]:
    """The network of a checkpoint, ready to answer, and the checkpoint's own account of itself.

    Raises:
        ValueError: Its configuration is of no network of ours.
    """
    state: dict[str, Any] = torch.load(checkpoint, weights_only=True)
    network = build_saved(state["config"]["network"])
    network.load_state_dict(state["network"])
    return network.eval(), state
