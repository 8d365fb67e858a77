"""A larger network that begins as a smaller one: it answers alike, and has room to learn more.

New channels are computed from the start but weigh nothing in what was there before; new residual blocks begin as
nothing by themselves (`ReconstructionNetwork`).

Source: Chen et al., "Net2Net: Accelerating Learning via Knowledge Transfer", ICLR 2016, of which this is the variant
without copies.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import torch
from torch import Tensor, nn

_JOINED = re.compile(r"merge\.\d+\.0\.conv\.weight")
"""Weights whose inputs are two sets of channels, one after the other; each grows at its own end."""


def grow(network: nn.Module, smaller: Mapping[str, Tensor]) -> list[str]:
    """Give a network the weights of another of the same kind wherever it is as large or larger.

    Args:
        network: Keeps its own weights where the other has none; those may not weigh in what the other knows, as new
            residual blocks of `ReconstructionNetwork` do not.
        smaller: State of the other.

    Returns:
        Names of the tensors that were taken.
    """
    state = network.state_dict()
    taken = [name for name, own in state.items() if name in smaller and _fits(own, smaller[name])]
    for name in taken:
        state[name] = _grown(state[name], smaller[name], parts=2 if _JOINED.search(name) else 1)
    network.load_state_dict(state)
    return taken


def _fits(own: Tensor, other: Tensor) -> bool:
    return own.dim() == other.dim() and all(a >= b for a, b in zip(own.shape, other.shape, strict=True))


def _grown(own: Tensor, other: Tensor, parts: int) -> Tensor:
    """The other's values where its channels are, nothing of the new ones into what these put out."""
    if own.dim() < 2:
        grown = own.clone()
        grown[tuple(slice(length) for length in other.shape)] = other
        return grown
    outputs, inputs = other.shape[:2]
    grown = own.clone()
    grown[:outputs] = 0
    for part, values in enumerate(other.split(inputs // parts, dim=1)):
        first = part * (own.shape[1] // parts)
        grown[:outputs, first : first + values.shape[1]] = values
    return grown

