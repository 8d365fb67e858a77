"""From a checkpoint back to the network it was taken of."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch

from training.networks.deformation import DeformationConfig, DeformationNetwork
from training.networks.reconstruction import ReconstructionConfig, ReconstructionNetwork


def load_network(checkpoint: Path) -> tuple[DeformationNetwork | ReconstructionNetwork, dict[str, Any]]:
    """The network of a checkpoint, ready to answer, and the checkpoint's own account of itself.

    Which network it is shows in its configuration: only a deformation network has a latent.
    """
    state: dict[str, Any] = torch.load(checkpoint, weights_only=True)
    saved: dict[str, Any] = state["config"]["network"]
    options: dict[str, Any] = {key: tuple(value) if isinstance(value, list) else value for key, value in saved.items()}
    network: DeformationNetwork | ReconstructionNetwork
    if "latent" in options:
        network = DeformationNetwork(DeformationConfig(**options))
    else:
        network = ReconstructionNetwork(ReconstructionConfig(**options))
    network.load_state_dict(state["network"])
    return network.eval(), state
