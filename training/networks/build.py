"""From a configuration to its network. Nothing is decided here: every number stands in the configuration."""

from __future__ import annotations

import dataclasses
from typing import Any, TypeAlias

from torch import nn

from training.networks.conditions import ConditionConfig
from training.networks.critic import Critic, CriticConfig
from training.networks.deformation import DeformationConfig, DeformationNetwork
from training.networks.physnet import PhysNet, PhysNetConfig
from training.networks.recgan import RecGan, RecGanConfig
from training.networks.reconstruction import ReconstructionConfig, ReconstructionNetwork

DeformationKind: TypeAlias = DeformationConfig | PhysNetConfig
ReconstructionKind: TypeAlias = ReconstructionConfig | RecGanConfig


def build_deformation(config: DeformationKind) -> DeformationNetwork | PhysNet:
    """The generator of deformations."""
    return PhysNet(config) if isinstance(config, PhysNetConfig) else DeformationNetwork(config)


def build_reconstruction(config: ReconstructionKind) -> ReconstructionNetwork | RecGan:
    """The generator of full shapes."""
    return RecGan(config) if isinstance(config, RecGanConfig) else ReconstructionNetwork(config)


def build_critic(config: CriticConfig) -> Critic:
    """The critic of either."""
    return Critic(config)


def build_saved(saved: dict[str, Any]) -> nn.Module:
    """The network of a configuration read back from a checkpoint: the fields tell whose it is.

    Raises:
        ValueError: It is none of ours.
    """
    deformation = (DeformationConfig, PhysNetConfig)
    for kind in (*deformation, ReconstructionConfig, RecGanConfig):
        if saved.keys() == {field.name for field in dataclasses.fields(kind)}:
            options = {key: _restored(value) for key, value in saved.items()}
            config: Any = kind(**options)
            return build_deformation(config) if isinstance(config, deformation) else build_reconstruction(config)
    raise ValueError(f"no network has a configuration of {', '.join(saved)}")


def _restored(value: Any) -> Any:
    """Lists of a file as tuples; a nested table is the encoding of a condition."""
    if isinstance(value, dict):
        return ConditionConfig(**{key: _restored(item) for key, item in value.items()})
    return tuple(value) if isinstance(value, list) else value
