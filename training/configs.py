"""What a training run is made of: frozen, saved in every checkpoint, and by name for the command line.

`paper` is the published architecture and what the authors' released code adds; `realtime` plays the same roles on a
CPU in a camera's period. `icgan` is the paper's baseline.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Bool

from service.core.condition import CONDITION_FIELDS
from training.data.batches import DeformationSet
from training.data.view_augmentation import ViewAugmentation
from training.networks.build import DeformationKind, ReconstructionKind
from training.networks.conditions import ConditionConfig
from training.networks.critic import CriticConfig
from training.networks.deformation import DeformationConfig
from training.networks.physnet import PhysNetConfig
from training.networks.recgan import RecGanConfig
from training.networks.reconstruction import ReconstructionConfig

KL_PER_VOXEL = 1.0 / 64**3
"""Weight of a nat of divergence beside a cross-entropy averaged over the grid.

The evidence bound adds the divergence, summed over the latent, to the cross-entropy summed over the voxels; dividing
both by the number of voxels leaves this. The released code divides the cross-entropy only, and so asks of each nat
that it pays for itself 262,144 times: the posterior collapses onto the prior.
"""


@dataclass(frozen=True)
class OptimizerConfig:
    """AdamW with gradients clipped, over one rise and fall of the learning rate.

    Attributes:
        learning_rate: The highest.
        warm_up: Steps of the rise; 0 holds the rate constant throughout, as the paper does.
        betas: Decay of the moments.
        clip: Largest norm of the gradient; None leaves it as it is.
    """

    learning_rate: float = 1e-3
    warm_up: int = 200
    weight_decay: float = 1e-4
    betas: tuple[float, float] = (0.9, 0.99)
    clip: float | None = 1.0


PAPER_OPTIMIZER = OptimizerConfig(learning_rate=5e-5, warm_up=0, weight_decay=0.0, betas=(0.5, 0.999), clip=None)
"""Source: the paper, section 4.2."""


@dataclass(frozen=True)
class AdversaryConfig:
    """The critic and how it is played against.

    Attributes:
        critic: Its network.
        optimizer: Its own; the moments must forget quickly, as what is judged changes under it.
        beta: β of the total loss once the critic counts in full: 0.95 leaves it 5 parts in 100.
        start: Step at which the critic begins to count; it trains `head_start` steps before.
        ramp: Steps until it counts in full.
        head_start: Steps that the critic trains before it counts.
        penalty: λ of the gradient penalty.
        critic_steps: Updates of the critic for each of the generator, on the same outcomes with fresh mixtures.
    """

    critic: CriticConfig = field(default_factory=CriticConfig)
    optimizer: OptimizerConfig = PAPER_OPTIMIZER
    beta: float = 0.95
    start: int = 1000
    ramp: int = 500
    head_start: int = 200
    penalty: float = 10.0
    critic_steps: int = 1


@dataclass(frozen=True, kw_only=True)
class FitConfig:
    """What both networks' runs have in common.

    Attributes:
        optimizer: Of the generator.
        adversary: None trains without a critic.
        alpha: α of the modified cross-entropy.
        begun_from: The run, and what it had seen, whose weights this one began with; None for random ones.
        more: Sets besides the first that are trained on too, in words; None where there are none.
        validation_samples: An evenly spread part of the validation split.
    """

    seed: int = 0
    steps: int = 2000
    optimizer: OptimizerConfig = OptimizerConfig()
    adversary: AdversaryConfig | None = None
    alpha: float = 0.5
    begun_from: str | None = None
    more: tuple[str, ...] | None = None
    validate_every: int = 500
    validation_samples: int = 200


@dataclass(frozen=True, kw_only=True)
class HeldOut:
    """Samples of some families, or with one field of the condition within a band.

    Attributes:
        families: Of the bodies.
        field: One of `service.core.condition.CONDITION_FIELDS`; None looks at the families alone.
        low: Where the band begins.
        high: Where it ends.
    """

    families: tuple[str, ...] = ()
    field: str | None = None
    low: float = -math.inf
    high: float = math.inf

    def holds(self, samples: DeformationSet) -> Bool[np.ndarray, " n"]:
        """Which samples are of this kind."""
        found = np.isin(np.array(samples.family)[samples.body], self.families)
        if self.field is not None:
            values = samples.condition[:, CONDITION_FIELDS.index(self.field)]
            found |= (values >= self.low) & (values <= self.high)
        return found


@dataclass(frozen=True, kw_only=True)
class FitDeformationConfig(FitConfig):
    """All that a run is made of.

    Attributes:
        bodies: Bodies of a batch.
        loads: Loads on each of them: the encoder, half of the work, is paid once a body.
        points: Voxels of each sample at which a displacement's occupancy is compared, most of them near a surface.
        occupancy_weight: Weight of that cross-entropy beside the relative displacement error, of order one each.
        kl_weight: Weight of the latent's divergence from its prior, per nat.
        held_out: What is not trained on, to see what that does there.
        lattice: Learn displacements on the lattice of the coarse solve alone (`training.data.lattice`), not what is
            looked up: four times as many steps in the same time.
    """

    network: DeformationKind = field(default_factory=DeformationConfig)
    bodies: int = 16
    loads: int = 2
    occupancy_weight: float = 1.0
    kl_weight: float = 1e-4
    points: int = 1536
    held_out: HeldOut | None = None
    lattice: bool = False


@dataclass(frozen=True, kw_only=True)
class FitReconstructionConfig(FitConfig):
    """All that a run is made of.

    Attributes:
        batch: Views of a batch.
        iou_weight: Weight of the soft IoU beside the cross-entropy, which alone is about a tenth of it.
        overrule: Whether voxels seen to be free count as empty whatever the network says, as they do where it is
            served; else it is asked to say so itself.
        augmentation: How views are changed before they are learned from; None leaves them but for mirror images.
        bfloat16: Whether products are rounded to 8 bits of mantissa, where a processor can: a step in two thirds of
            the time.
    """

    network: ReconstructionKind = field(default_factory=ReconstructionConfig)
    batch: int = 8
    iou_weight: float = 0.1
    overrule: bool = True
    augmentation: ViewAugmentation | None = None
    bfloat16: bool = False


REAL = ConditionConfig(encoding="real")
SMALL_CRITIC = (16, 32, 64, 64)
"""Channels of a critic that costs about as much as a realtime generator."""

REALTIME = FitDeformationConfig(
    steps=2800, optimizer=OptimizerConfig(learning_rate=7e-4, weight_decay=0.1), validate_every=400,
    validation_samples=120, points=768,
)

DEFORMATION_PRESETS: dict[str, FitDeformationConfig] = {
    "realtime": REALTIME,
    # A tenth of the divergence's weight, with no cross-entropy beside it: at all of it hardly a latent is active.
    "realtime-lattice": replace(REALTIME, lattice=True, steps=1200, validate_every=200, kl_weight=1e-5),
    "realtime-gan": replace(
        REALTIME,
        adversary=AdversaryConfig(
            critic=CriticConfig(channels=SMALL_CRITIC, condition=ConditionConfig()),
            optimizer=OptimizerConfig(learning_rate=2e-4, warm_up=0, weight_decay=0.0, betas=(0.5, 0.999)),
        ),
    ),
    "paper": FitDeformationConfig(
        network=PhysNetConfig(), optimizer=PAPER_OPTIMIZER, alpha=0.85, kl_weight=KL_PER_VOXEL, bodies=8, loads=1,
        adversary=AdversaryConfig(critic=CriticConfig(condition=REAL)),
    ),
    "icgan": FitDeformationConfig(
        network=PhysNetConfig(variational=False), optimizer=PAPER_OPTIMIZER, alpha=0.85, kl_weight=0.0, bodies=8,
        loads=1, adversary=AdversaryConfig(critic=CriticConfig(condition=REAL)),
    ),
}  # fmt: skip

RECONSTRUCTION_PRESETS: dict[str, FitReconstructionConfig] = {
    "realtime": FitReconstructionConfig(optimizer=OptimizerConfig(learning_rate=2e-3)),
    "realtime-gan": FitReconstructionConfig(
        adversary=AdversaryConfig(
            critic=CriticConfig(given_channels=2, channels=SMALL_CRITIC),
            optimizer=OptimizerConfig(learning_rate=2e-4, warm_up=0, weight_decay=0.0, betas=(0.5, 0.999)),
        ),
    ),
    "paper": FitReconstructionConfig(
        network=RecGanConfig(), optimizer=PAPER_OPTIMIZER, alpha=0.85, batch=8, iou_weight=0.0, overrule=False,
        adversary=AdversaryConfig(critic=CriticConfig(given_channels=2)),
    ),
    "realtime-augmented": FitReconstructionConfig(augmentation=ViewAugmentation()),
    "realtime-deep": FitReconstructionConfig(
        network=ReconstructionConfig(blocks=(1, 4, 4, 3), silent=True), augmentation=ViewAugmentation(), bfloat16=True
    ),
}  # fmt: skip


class ConfigError(Exception):
    """There is no such configuration; the message names those that there are."""


ConfigT = TypeVar("ConfigT", bound=FitConfig)


def chosen(
    presets: Mapping[str, ConfigT], preset: str, steps: int | None, learning_rate: float | None, seed: int | None
) -> ConfigT:
    """A preset with what a command line changes of it; None leaves what it says.

    Raises:
        ConfigError: There is no preset of that name.
    """
    if preset not in presets:
        raise ConfigError(f"there is no preset {preset}; choose one of {', '.join(presets)}")
    config = presets[preset]
    changes: dict[str, Any] = {key: value for key, value in (("steps", steps), ("seed", seed)) if value is not None}
    if learning_rate is not None:
        changes["optimizer"] = replace(config.optimizer, learning_rate=learning_rate)
    return replace(config, **changes)
