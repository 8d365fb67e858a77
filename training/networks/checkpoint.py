"""From a checkpoint back to the network it was taken of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import nn

from training.networks.build import build_saved


def load_network(checkpoint: Path) -> tuple[nn.Module, dict[str, Any]]:
    """The network of a checkpoint, ready to answer, and the checkpoint's own account of itself.

    Raises:
        ValueError: Its configuration is of no network of ours.
    """
    state: dict[str, Any] = torch.load(checkpoint, weights_only=True)
    network = build_saved(state["config"]["network"])
    network.load_state_dict(state["network"])
    return network.eval(), state
