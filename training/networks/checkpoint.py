"""From a checkpoint back to the network it was taken of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import nn

from training.networks.build import build_saved


def take_weights(network: nn.Module, checkpoint: Path) -> str:
    """Give a network the weights of another run wherever name and shape are the same.

    Returns:
        What was taken: run, step, data and the number of tensors.

    Raises:
        ValueError: Nothing fits.
    """
    state: dict[str, Any] = torch.load(checkpoint, weights_only=True)
    own = network.state_dict()
    fitting = {name: tensor for name, tensor in state["network"].items() if _same_shape(own.get(name), tensor)}
    if not fitting:
        raise ValueError(f"no weight of {checkpoint} fits this network")
    network.load_state_dict(fitting, strict=False)
    return (
        f"{checkpoint.parent.name} at step {state['step']}, trained on {state['dataset']['digest']}: "
        f"{len(fitting)} of {len(own)} tensors"
    )


def _same_shape(own: torch.Tensor | None, other: torch.Tensor) -> bool:
    return own is not None and own.shape == other.shape


def load_network(checkpoint: Path) -> tuple[nn.Module, dict[str, Any]]:
    """The network of a checkpoint, ready to answer, and the checkpoint's own account of itself.

    Raises:
        ValueError: Its configuration is of no network of ours.
    """
    state: dict[str, Any] = torch.load(checkpoint, weights_only=True)
    network = build_saved(state["config"]["network"])
    network.load_state_dict(state["network"])
    return network.eval(), state
